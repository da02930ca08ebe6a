// One panel of points on uPlot: axes, brush and keyboard are shared; what is drawn in it is the caller's.

import { css } from "./dom.js";

const PAD = 0.04;

export function extent(values, least = 0) {
  let low = Infinity, high = -Infinity;
  for (const value of values) {
    if (value < low) low = value;
    if (value > high) high = value;
  }
  if (!Number.isFinite(low)) return [-1, 1];
  const room = PAD * (high - low) || Math.abs(high) * PAD || 1;
  return [Math.min(low - room, -least || low - room), Math.max(high + room, least || high + room)];
}

export class Chart {
  // `onBrush` gets the rectangle in the units of the axes, and whether it is added to others.
  constructor(place, { onBrush, draw, both }) {
    Object.assign(this, { place, onBrush, draw, both, window: null });
    this.ranges = { x: [0, 1], y: [0, 1] };
    place.tabIndex = 0;
    place.addEventListener("keydown", (event) => this.key(event));
    new ResizeObserver(() => this.resize()).observe(place);
    this.build();
  }

  build() {
    this.plot?.destroy();
    const stroke = css("--quiet"), grid = { stroke: css("--line"), width: 0.6 };
    const axis = { stroke, grid, ticks: { stroke: css("--line"), width: 0.6 }, font: "11px system-ui, sans-serif", labelFont: "11px system-ui, sans-serif", labelSize: 16 };
    const { width, height } = this.size();
    this.plot = new window.uPlot({
      width, height, legend: { show: false }, padding: [14, 10, 0, 0],
      cursor: { points: { show: false }, drag: { x: true, y: this.both, uni: 12, setScale: false }, focus: { prox: -1 } },
      select: { show: true, left: 0, top: 0, width: 0, height: 0 },
      scales: { x: { time: false, range: () => this.ranges.x }, y: { range: () => this.ranges.y } },
      axes: [{ ...axis, size: 30, label: this.xLabel || "", space: 60 }, { ...axis, size: 66, label: this.yLabel || "", space: 26 }],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: { draw: [(u) => this.paint(u)], setSelect: [(u) => this.selected(u)] },
    }, [[0, 1], [0, 1]], this.place);
    this.plot.over.addEventListener("mousedown", (event) => { this.added = event.shiftKey || event.ctrlKey; });
  }

  size() {
    return { width: Math.max(this.place.clientWidth, 120), height: Math.max(this.place.clientHeight, 80) };
  }

  resize() {
    const { width, height } = this.size();
    if (width !== this.plot.width || height !== this.plot.height) this.plot.setSize({ width, height });
  }

  paint(u) {
    const context = u.ctx, box = u.bbox;
    context.save();
    context.beginPath();
    context.rect(box.left, box.top, box.width, box.height);
    context.clip();
    this.paintOn(context);
    context.restore();
  }

  paintOn(context) {
    const u = this.plot;
    this.draw?.(context, { x: (v) => u.valToPos(v, "x", true), y: (v) => u.valToPos(v, "y", true), box: u.bbox, ratio: devicePixelRatio || 1 });
  }

  show(ranges, xLabel, yLabel) {
    if (xLabel !== this.xLabel || yLabel !== this.yLabel) {
      Object.assign(this, { xLabel, yLabel });
      this.ranges = ranges;
      this.build();
    }
    this.ranges = ranges;
    this.plot.setData([ranges.x, ranges.y], true);
  }

  selected(u) {
    const { left, top, width, height } = u.select;
    if (width < 3 && height < 3) return;
    const x = [left, left + width].map((at) => u.posToVal(at, "x")), y = [top + height, top].map((at) => u.posToVal(at, "y"));
    u.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.onBrush({ x, y: this.both && height < u.over.clientHeight - 4 ? y : null }, Boolean(this.added));
  }

  // With the keyboard a window of the abscissa is moved by ← →, and made wider or narrower by ⇧← ⇧→.
  key(event) {
    if (!["ArrowLeft", "ArrowRight"].includes(event.key) || event.altKey || event.ctrlKey || event.metaKey) return;
    event.preventDefault();
    const [low, high] = this.ranges.x, step = (high - low) / 20, way = event.key === "ArrowRight" ? 1 : -1;
    const [from, to] = this.window ?? [low, low + 2 * step];
    const moved = event.shiftKey ? [from, Math.max(to + way * step, from + step / 4)] : [from + way * step, to + way * step];
    if (moved[1] <= low || moved[0] >= high) return;
    this.window = moved;
    this.onBrush({ x: moved, y: null }, false);
  }
}

export function shape(context, kind, x, y, size) {
  context.moveTo(x + size, y);
  if (kind === "circle") context.arc(x, y, size, 0, 2 * Math.PI);
  else if (kind === "square") context.rect(x - size, y - size, 2 * size, 2 * size);
  else {
    const corners = kind === "diamond" ? [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]] : [[0, -1.25], [1.2, 0.95], [-1.2, 0.95]];
    context.moveTo(x + corners[0][0] * size, y + corners[0][1] * size);
    for (const [a, b] of corners.slice(1)) context.lineTo(x + a * size, y + b * size);
    context.closePath();
  }
}
