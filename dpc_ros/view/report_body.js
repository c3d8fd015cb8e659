/* The body, drawn to scale at any time of the run. */

const MISSING = 65535; // level of a position that is not known
const STAGE = { l: 38, r: 12, t: 10, b: 22 }; // px around the body
const ARROW = 0.2; // of the stage, length of the largest force
const TICK = 70; // px from one to the next, at least
const SMALL_BODY = 1500; // masses, up to which each has its dot

class Positions {
  constructor({ low, step, level }, masses) {
    this.low = low;
    this.step = step;
    this.level = unpack(level);
    this.size = 2 * masses;
    this.values = new Float64Array(this.size);
  }

  isKnown(frame) {
    return frame >= 0 && this.level[frame * this.size] !== MISSING;
  }

  /* Positions at a frame, or that share of the way to the next one; null where they are missing. */
  at(frame, share = 0) {
    if (!this.isKnown(frame)) return null;
    const start = frame * this.size;
    const isBetween = share > 0 && this.isKnown(frame + 1);
    for (let i = 0; i < this.size; i += 1) {
      let level = this.level[start + i];
      if (isBetween) level += share * (this.level[start + this.size + i] - level);
      this.values[i] = this.low[i % 2] + this.step[i % 2] * level;
    }
    return this.values;
  }
}

class Body {
  constructor(motion, canvas) {
    this.canvas = canvas;
    // By the processor: many lines take long on a graphics card, and for ever on one in software.
    this.context = canvas.getContext('2d', { willReadFrequently: true });
    this.motion = motion;
    this.time = unpack(motion.time);
    this.springs = unpack(motion.springs);
    this.restLength = unpack(motion.rest_length);
    this.target = unpack(motion.target);
    this.force = unpack(motion.force);
    this.nmse = unpack(motion.nmse);
    this.reconstructionError = unpack(motion.reconstruction_error);
    const masses = unpack(motion.body.level).length / this.time.length / 2;
    this.body = new Positions(motion.body, masses);
    this.reconstruction = motion.reconstruction && new Positions(motion.reconstruction, masses);
    this.targets = new Positions(motion.targets, masses);
    this.layers = { target: true, reconstruction: true, force: true };
    this.largestForce = 0;
    for (let k = 0; k < this.time.length; k += 1) {
      const norm = this.forceNorm(k);
      if (norm > this.largestForce && Number.isFinite(norm)) this.largestForce = norm;
    }
  }

  get end() {
    return this.time[this.time.length - 1];
  }

  forceNorm(frame) {
    return Math.hypot(this.force[2 * frame], this.force[2 * frame + 1]);
  }

  /* The last frame at or before a time. */
  frameAt(time) {
    let low = 0;
    let high = this.time.length - 1;
    while (low < high) {
      const middle = Math.ceil((low + high) / 2);
      if (this.time[middle] <= time) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  draw(time) {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth: width, clientHeight: height } = this.canvas;
    const size = [Math.round(width * ratio), Math.round(height * ratio)];
    if (this.canvas.width !== size[0] || this.canvas.height !== size[1] || !this.scale) {
      [this.canvas.width, this.canvas.height] = size;
      this.fit(width, height);
    }
    const { context } = this;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    context.clearRect(0, 0, width, height);
    this.drawAxes(context, width, height);
    const frame = this.frameAt(time);
    const gap = this.time[frame + 1] - this.time[frame];
    const share = gap <= this.motion.interpolated_gap ? (time - this.time[frame]) / gap : 0;
    const ghost = this.layers.target && this.targets.at(this.target[frame]);
    if (ghost) this.drawPlain(context, ghost, colour('target'), 0.4, 3);
    const body = this.body.at(frame, share);
    if (!body) {
      this.say(context, width, height, 'the body is not finite, or far away');
      return;
    }
    const decoded = this.layers.reconstruction && this.reconstruction && this.reconstruction.at(frame, share);
    if (decoded) this.drawPlain(context, decoded, colour('reconstruction'), 0.9, 1.2);
    this.drawStrained(context, body);
    this.drawMasses(context, body);
    if (this.layers.force) this.drawForce(context, body, frame, width);
  }

  /* The same scale and place for the whole run, with room for the body and the arrow of its force. */
  fit(width, height) {
    const { limits, mass } = this.motion;
    this.longestArrow = ARROW * Math.min(width, height);
    this.place(limits, width, height);
    if (mass === null || !this.largestForce) return;
    const [low, high] = [limits.slice(0, 2), limits.slice(2)];
    const metres = this.longestArrow / this.scale / this.largestForce; // per newton
    for (let frame = 0; frame < this.time.length; frame += 1) {
      const positions = this.body.at(frame);
      if (!positions || !Number.isFinite(this.forceNorm(frame))) continue;
      for (let axis = 0; axis < 2; axis += 1) {
        const tip = positions[2 * mass + axis] + metres * this.force[2 * frame + axis];
        low[axis] = Math.min(low[axis], tip);
        high[axis] = Math.max(high[axis], tip);
      }
    }
    this.place([...low, ...high], width, height);
  }

  place([left, bottom, right, top], width, height) {
    const room = [width - STAGE.l - STAGE.r, height - STAGE.t - STAGE.b];
    this.scale = Math.max(Math.min(room[0] / (right - left), room[1] / (top - bottom)), 1e-6);
    this.originX = STAGE.l + room[0] / 2 - (this.scale * (left + right)) / 2;
    this.originY = STAGE.t + room[1] / 2 + (this.scale * (bottom + top)) / 2;
  }

  x(value) {
    return this.originX + this.scale * value;
  }

  y(value) {
    return this.originY - this.scale * value;
  }

  drawAxes(context, width, height) {
    const least = TICK / this.scale;
    const decade = 10 ** Math.floor(Math.log10(least));
    const step = decade * ([1, 2, 5].find((factor) => factor * decade >= least) ?? 10);
    const [right, bottom] = [width - STAGE.r, height - STAGE.b];
    context.font = `11px ${style.fontFamily}`;
    context.fillStyle = colour('soft');
    context.strokeStyle = colour('grid');
    context.lineWidth = 1;
    context.beginPath();
    context.textAlign = 'center';
    context.textBaseline = 'top';
    for (let k = Math.ceil((STAGE.l - this.originX) / this.scale / step); this.x(k * step) <= right; k += 1) {
      const x = Math.round(this.x(k * step)) + 0.5;
      context.moveTo(x, STAGE.t);
      context.lineTo(x, bottom);
      context.fillText(digits(k * step, k === 0 ? 'm' : ''), x, bottom + 5);
    }
    context.textAlign = 'right';
    context.textBaseline = 'middle';
    for (let k = Math.ceil((this.originY - bottom) / this.scale / step); this.y(k * step) >= STAGE.t; k += 1) {
      const y = Math.round(this.y(k * step)) + 0.5;
      context.moveTo(STAGE.l, y);
      context.lineTo(right, y);
      context.fillText(digits(k * step, ''), STAGE.l - 5, y);
    }
    context.stroke();
  }

  drawPlain(context, positions, stroke, alpha, width) {
    context.save();
    context.globalAlpha = alpha;
    context.strokeStyle = stroke;
    context.lineWidth = width;
    context.lineJoin = 'round';
    context.beginPath();
    for (let j = 0; j < this.springs.length; j += 2) {
      const [a, b] = [2 * this.springs[j], 2 * this.springs[j + 1]];
      context.moveTo(this.x(positions[a]), this.y(positions[a + 1]));
      context.lineTo(this.x(positions[b]), this.y(positions[b + 1]));
    }
    context.stroke();
    context.restore();
  }

  /* Springs of one colour are one path: a canvas is slow at changing its colour. */
  drawStrained(context, positions) {
    const { colours, largest_strain: largest } = this.motion;
    const paths = new Array(colours.length);
    for (let j = 0; j < this.restLength.length; j += 1) {
      const [a, b] = [2 * this.springs[2 * j], 2 * this.springs[2 * j + 1]];
      const [x, y, u, v] = [positions[a], positions[a + 1], positions[b], positions[b + 1]];
      const rest = this.restLength[j];
      const strain = (Math.hypot(u - x, v - y) - rest) / (rest || 1);
      const share = Math.min(Math.max((1 + strain / largest) / 2, 0), 1);
      const place = Math.round(share * (colours.length - 1));
      paths[place] ??= new Path2D();
      paths[place].moveTo(this.x(x), this.y(y));
      paths[place].lineTo(this.x(u), this.y(v));
    }
    context.lineWidth = this.restLength.length > SMALL_BODY ? 1 : 1.8;
    context.lineCap = 'round';
    paths.forEach((path, place) => {
      context.strokeStyle = colours[place];
      context.stroke(path);
    });
  }

  drawMasses(context, positions) {
    context.fillStyle = colour('text');
    if (positions.length <= 2 * SMALL_BODY) {
      context.globalAlpha = 0.4;
      context.beginPath();
      for (let i = 0; i < positions.length; i += 2) {
        const [x, y] = [this.x(positions[i]), this.y(positions[i + 1])];
        context.moveTo(x, y);
        context.arc(x, y, 1.3, 0, 2 * Math.PI);
      }
      context.fill();
      context.globalAlpha = 1;
    }
    for (const mass of this.motion.fixed) {
      context.fillRect(this.x(positions[2 * mass]) - 4, this.y(positions[2 * mass + 1]) - 4, 8, 8);
    }
  }

  drawForce(context, positions, frame, width) {
    const { mass } = this.motion;
    const norm = this.forceNorm(frame);
    if (mass === null || !(norm > 0) || !Number.isFinite(norm)) return;
    const [x, y] = [this.x(positions[2 * mass]), this.y(positions[2 * mass + 1])];
    const length = (this.longestArrow * norm) / this.largestForce;
    const [dx, dy] = [this.force[2 * frame] / norm, -this.force[2 * frame + 1] / norm];
    const head = Math.min(11, 0.7 * length + 3);
    const [tipX, tipY] = [x + length * dx, y + length * dy];
    for (const [stroke, extra] of [[colour('surface'), 4], [colour('text'), 0]]) {
      context.strokeStyle = stroke;
      context.fillStyle = stroke;
      context.lineWidth = 2.6 + extra;
      context.lineJoin = 'round';
      context.beginPath();
      context.moveTo(x, y);
      context.lineTo(tipX - 0.6 * head * dx, tipY - 0.6 * head * dy);
      context.stroke();
      context.beginPath();
      context.moveTo(tipX, tipY);
      context.lineTo(tipX - head * dx - 0.5 * head * dy, tipY - head * dy + 0.5 * head * dx);
      context.lineTo(tipX - head * dx + 0.5 * head * dy, tipY - head * dy - 0.5 * head * dx);
      context.closePath();
      if (extra) context.stroke();
      else context.fill();
    }
    context.beginPath();
    context.arc(x, y, 4, 0, 2 * Math.PI);
    context.fill();
    context.font = `600 12px ${style.fontFamily}`;
    context.textAlign = 'left';
    context.textBaseline = 'middle';
    context.lineWidth = 3;
    context.strokeStyle = colour('surface');
    const label = digits(norm, 'N');
    const extent = context.measureText(label).width;
    const beside = tipX + (dx < 0 ? -8 - extent : 8);
    const [labelX, labelY] = [Math.max(0, Math.min(beside, width - extent)), tipY + 10 * dy];
    context.strokeText(label, labelX, labelY);
    context.fillText(label, labelX, labelY);
  }

  say(context, width, height, text) {
    context.font = `italic 14px ${style.fontFamily}`;
    context.fillStyle = colour('soft');
    context.textAlign = 'center';
    context.textBaseline = 'middle';
    context.fillText(text, width / 2, height / 2);
  }
}
