/* The plots: one look, one stretch of time, one cursor. */

const MARGIN = { l: 56, r: 12, t: 8, b: 26 }; // px around the curves
const BUTTONS = ['toImage', 'zoom2d', 'pan2d', 'zoomIn2d', 'zoomOut2d', 'resetScale2d'];
const LEGEND = 26; // px above them

function themed(layout) {
  const axis = {
    gridcolor: colour('grid'),
    linecolor: colour('line'),
    zerolinecolor: colour('line'),
    automargin: false,
  };
  return {
    ...layout,
    autosize: true,
    margin: { ...MARGIN, t: layout.showlegend ? LEGEND : MARGIN.t, autoexpand: false },
    paper_bgcolor: colour('surface'),
    plot_bgcolor: colour('surface'),
    font: { color: colour('text'), family: style.fontFamily, size: 12 },
    hoverlabel: { bgcolor: colour('surface'), bordercolor: colour('line'), font: { color: colour('text') } },
    legend: { orientation: 'h', x: 0, y: 1, yanchor: 'bottom', itemsizing: 'constant', bgcolor: 'rgba(0,0,0,0)' },
    modebar: { bgcolor: 'rgba(0,0,0,0)', color: colour('soft'), activecolor: colour('text') },
    hoverdistance: -1,
    xaxis: { ...layout.xaxis, ...axis, spikecolor: colour('soft'), spikethickness: 1 },
    yaxis: { ...layout.yaxis, ...axis, tickfont: { size: layout.yaxis.type === 'log' ? 10 : 12 } },
  };
}

function coloured(curves) {
  return curves.map((curve) => (
    curve.meta.foreground ? { ...curve, line: { ...curve.line, color: colour('text') } } : curve
  ));
}

class Plots {
  constructor(onPick) {
    this.onPick = onPick;
    this.time = 0;
    this.zooming = false;
    this.plots = Object.entries(report.figures).map(([key, figure]) => {
      const holder = document.querySelector(`[data-panel="${key}"]`);
      const cursor = document.createElement('div');
      cursor.className = 'cursor';
      cursor.hidden = true;
      return { holder, figure, cursor };
    });
    this.drawAll();
  }

  /* One after the other, so that the page answers meanwhile. */
  async drawAll() {
    for (const plot of this.plots) {
      this.draw(plot);
      await new Promise((resolve) => { setTimeout(resolve); });
    }
  }

  draw(plot) {
    const { holder, figure, cursor } = plot;
    Plotly.newPlot(holder, coloured(figure.data), themed(figure.layout), {
      displaylogo: false,
      doubleClick: 'reset',
      responsive: true,
      modeBarButtons: [BUTTONS],
    });
    holder.append(cursor);
    plot.isDrawn = true;
    this.place(plot);
    holder.on('plotly_click', ({ points }) => this.onPick(points[0].x));
    holder.on('plotly_afterplot', () => this.place(plot));
    holder.on('plotly_relayout', (change) => this.zoomOthers(plot, change));
  }

  zoomOthers(plot, change) {
    const range = change['xaxis.range'] ?? [change['xaxis.range[0]'], change['xaxis.range[1]']];
    if (this.zooming || range[0] === undefined) return;
    this.zooming = true;
    const others = this.plots.filter((other) => other !== plot && other.isDrawn);
    Promise.all(others.map((other) => Plotly.relayout(other.holder, { 'xaxis.range': [...range] })))
      .finally(() => { this.zooming = false; });
  }

  theme() {
    for (const { holder, figure, isDrawn } of this.plots) {
      if (!isDrawn) continue;
      const range = [...holder.layout.xaxis.range];
      const layout = themed(figure.layout);
      Plotly.react(holder, coloured(figure.data), { ...layout, xaxis: { ...layout.xaxis, range } });
    }
  }

  show(time) {
    this.time = time;
    for (const plot of this.plots) this.place(plot);
  }

  place({ holder, cursor, isDrawn }) {
    if (!isDrawn) return;
    const { l, t, w, h } = holder._fullLayout._size;
    const [first, last] = holder.layout.xaxis.range;
    const share = (this.time - first) / (last - first);
    cursor.hidden = !(report.animation && share >= 0 && share <= 1);
    cursor.style.left = `${l + share * w}px`;
    cursor.style.top = `${t}px`;
    cursor.style.height = `${h}px`;
  }
}
