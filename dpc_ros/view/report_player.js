/* The time that body and plots show, and what moves it. */

const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 5, 10, 60, 600]; // simulated per wall second
const LONGEST_PLAY = 60; // s that a run takes at the speed it begins with
const LEAP = 10; // frames that an arrow key with shift goes by

class Player {
  constructor(body, section) {
    const find = (selector) => section.querySelector(selector);
    this.body = body;
    this.buttons = [find('.play'), find('.start')];
    this.start = find('.start');
    this.scrub = find('.scrub');
    this.output = find('.time');
    this.readings = Object.fromEntries(
      [...section.querySelectorAll('[data-reading]')].map((each) => [each.dataset.reading, each]),
    );
    this.time = 0;
    this.playing = false;
    this.drawn = false;
    this.scrub.max = body.end;
    this.scrub.disabled = !(body.end > 0);
    for (const button of this.buttons) {
      button.disabled = this.scrub.disabled;
      button.addEventListener('click', () => this.toggle());
    }
    this.start.hidden = this.scrub.disabled;
    body.canvas.addEventListener('click', () => this.toggle());
    this.scrub.addEventListener('input', () => this.seek(Number(this.scrub.value)));
    this.fillSpeeds(find('.speed'));
    for (const box of section.querySelectorAll('[data-layer]')) this.bindLayer(box);
    document.addEventListener('keydown', (event) => this.press(event));
    new ResizeObserver(() => this.redraw()).observe(body.canvas);
  }

  fillSpeeds(select) {
    const wanted = SPEEDS.find((speed) => speed >= 1 && this.body.end / speed <= LONGEST_PLAY);
    this.speed = wanted ?? SPEEDS[SPEEDS.length - 1];
    for (const speed of SPEEDS) {
      select.add(new Option(`${speed}×`, speed, false, speed === this.speed));
    }
    select.addEventListener('change', () => { this.speed = Number(select.value); });
  }

  bindLayer(box) {
    const { layer } = box.dataset;
    const { body } = this;
    const isThere = {
      target: body.target.some((goal) => body.targets.isKnown(goal)),
      reconstruction: Boolean(body.reconstruction) && body.time.some((_, k) => body.reconstruction.isKnown(k)),
      force: body.largestForce > 0 && body.motion.mass !== null,
    }[layer];
    if (!isThere) {
      box.closest('label').hidden = true;
      this.readings[layer]?.parentElement.setAttribute('hidden', '');
      return;
    }
    body.layers[layer] = box.checked;
    box.addEventListener('change', () => {
      body.layers[layer] = box.checked;
      this.redraw();
    });
  }

  press(event) {
    if (this.scrub.disabled || event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.target.matches('select')) return;
    const leap = event.shiftKey ? LEAP : 1;
    const { body } = this;
    const frame = body.frameAt(this.time);
    if (event.key === 'ArrowLeft') this.seek(body.time[Math.max(frame - leap, 0)]);
    else if (event.key === 'ArrowRight') this.seek(body.time[Math.min(frame + leap, body.time.length - 1)]);
    else if (event.key === ' ' && !event.target.matches('button, summary, input[type=checkbox]')) this.toggle();
    else return;
    event.preventDefault();
  }

  toggle() {
    if (this.scrub.disabled) return;
    this.playing = !this.playing;
    if (this.playing) {
      if (this.time >= this.body.end) this.show(0);
      this.last = undefined;
      requestAnimationFrame((now) => this.advance(now));
    }
    this.label();
  }

  label() {
    this.start.hidden = true;
    for (const button of this.buttons) {
      button.textContent = this.playing ? '❚❚' : '▶';
      button.setAttribute('aria-label', this.playing ? 'Pause' : 'Play');
    }
  }

  advance(now) {
    if (!this.playing) return;
    const passed = this.last === undefined ? 0 : (now - this.last) / 1e3;
    this.last = now;
    this.show(Math.min(this.time + this.speed * passed, this.body.end));
    if (this.time >= this.body.end) {
      this.playing = false;
      this.label();
    } else {
      requestAnimationFrame((next) => this.advance(next));
    }
  }

  /* Go to a time and stay there. */
  seek(time) {
    this.playing = false;
    this.label();
    this.show(Math.min(Math.max(time, 0), this.body.end));
  }

  show(time) {
    this.time = time;
    this.scrub.value = time;
    const frame = this.body.frameAt(time);
    this.output.textContent = `${time.toFixed(3)} s`;
    this.readings.nmse.textContent = digits(this.body.nmse[frame], '');
    this.readings.force.textContent = digits(this.body.forceNorm(frame), 'N');
    this.readings.reconstruction.textContent = digits(1e3 * this.body.reconstructionError[frame], 'mm');
    this.onShow(time);
    this.redraw();
  }

  redraw() {
    if (this.drawn) return;
    this.drawn = true;
    requestAnimationFrame(() => {
      this.drawn = false;
      this.body.draw(this.time);
    });
  }
}

function begin() {
  if (!report.animation) {
    const plots = new Plots(() => {});
    dark.addEventListener('change', () => plots.theme());
    return;
  }
  const section = document.querySelector('.body');
  const { colours } = report.animation;
  section.querySelector('.ramp').style.background = `linear-gradient(to right, ${colours.join(', ')})`;
  const player = new Player(new Body(report.animation, section.querySelector('canvas')), section);
  const plots = new Plots((time) => player.seek(time));
  player.onShow = (time) => plots.show(time);
  dark.addEventListener('change', () => {
    plots.theme();
    player.redraw();
  });
  player.show(0);
}

begin();
