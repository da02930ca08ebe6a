// One panel of points on uPlot: axes, brush and keyboard are shared; what is drawn in it is the caller's.

import { css, ticks } from "./dom.js";

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

// A label that is longer than its axis would be cut; what is drawn stands above the panel as well.
function fitting(label, room) {
  return label && 6 * label.length <= room ? label : "";
}

export class Chart {
  // `onBrush` gets the rectangle in the units of the axes, and whether it is added to others; `places` returns where the
  // points are, `onPoint` and `onPick` get the one that is pointed at or clicked, `onZoom` another range of the abscissa.
  constructor(place, { onBrush, draw, both, places, onPoint, onPick, onZoom }) {
    Object.assign(this, { place, onBrush, draw, both, places, onPoint, onPick, onZoom, window: null, begun: null });
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
      width, height, legend: { show: false }, padding: [18, 10, 0, 0],
      cursor: { points: { show: false }, drag: { x: false, y: false, setScale: false }, focus: { prox: -1 } },
      select: { show: true, left: 0, top: 0, width: 0, height: 0 },
      scales: { x: { time: false, range: () => this.ranges.x }, y: { range: () => this.ranges.y } },
      axes: [{ ...axis, size: 30, label: this.xLabel || "", space: 60, values: (_, splits) => ticks(splits) }, { ...axis, size: 72, label: (u) => fitting(this.yLabel, u.over.clientHeight + 24), space: 26, values: (_, splits) => ticks(splits) }],
      series: [{}, { paths: () => null, points: { show: false } }],
      hooks: { draw: [(u) => this.paint(u)] },
    }, [[0, 1], [0, 1]], this.place);
    this.listen(this.plot.over);
  }

  // Mouse, touch and pen alike: a drag selects, a click or tap selects one reading, the wheel zooms.
  listen(over) {
    const at = (event) => {
      const box = over.getBoundingClientRect();
      return [Math.max(0, Math.min(box.width, event.clientX - box.left)), Math.max(0, Math.min(box.height, event.clientY - box.top))];
    };
    over.addEventListener("pointerdown", (event) => {
      if (event.button || !event.isPrimary || event.target.closest(".drawing")) return;
      over.setPointerCapture(event.pointerId);
      this.begun = { from: at(event), added: event.shiftKey || event.ctrlKey };
    });
    over.addEventListener("pointermove", (event) => {
      if (this.begun && event.isPrimary) this.frame(this.begun.from, at(event));
      else if (event.pointerType !== "touch") this.point(at(event));
    });
    over.addEventListener("pointerup", (event) => {
      const { begun } = this;
      if (!begun || !event.isPrimary) return;
      this.begun = null;
      const to = at(event), box = this.frame(begun.from, to);
      this.plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
      if (Math.hypot(to[0] - begun.from[0], to[1] - begun.from[1]) >= 5) this.selected(box, begun.added);
      else if (this.nearest(to) !== null) this.onPick(this.nearest(to), begun.added);
    });
    over.addEventListener("pointercancel", () => {
      this.begun = null;
      this.plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    });
    over.addEventListener("pointerleave", () => !this.begun && this.onPoint(null));
    over.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [low, high] = this.ranges.x, about = this.plot.posToVal(at(event)[0], "x"), factor = Math.exp(Math.max(-1, Math.min(1, event.deltaY / 300)));
      this.onZoom([about + factor * (low - about), about + factor * (high - about)]);
    }, { passive: false });
  }

  frame(from, to) {
    const { clientWidth, clientHeight } = this.plot.over, wide = Math.abs(to[0] - from[0]), high = Math.abs(to[1] - from[1]);
    // What is drawn along one axis alone means all of the other.
    const across = this.both && wide < 12 && high >= 12, along = !this.both || (high < 12 && !across);
    const box = {
      left: across ? 0 : Math.min(from[0], to[0]), width: across ? clientWidth : wide,
      top: along ? 0 : Math.min(from[1], to[1]), height: along ? clientHeight : high,
    };
    this.plot.setSelect(box, false);
    return box;
  }

  point(at) {
    const k = this.nearest(at);
    this.onPoint(k, at[0] + this.plot.over.offsetLeft, at[1] + this.plot.over.offsetTop);
  }

  // The point nearest to a place of the panel, within a finger's reach; null for none.
  nearest([left, top]) {
    const { x, y } = this.places() ?? { x: [], y: [] };
    let best = 14 ** 2, found = null;
    for (let k = 0; k < x.length; k++) {
      const across = this.plot.valToPos(x[k], "x") - left, up = this.plot.valToPos(y[k], "y") - top, size = across * across + up * up;
      if (size < best) [best, found] = [size, k];
    }
    return found;
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

  selected({ left, top, width, height }, added) {
    const x = [left, left + width].map((at) => this.plot.posToVal(at, "x")), y = [top + height, top].map((at) => this.plot.posToVal(at, "y"));
    this.onBrush({ x, y: this.both && height < this.plot.over.clientHeight - 4 ? y : null }, added);
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

const CORNERS = {
  diamond: [[0, -1.3], [1.3, 0], [0, 1.3], [-1.3, 0]], triangle: [[0, -1.25], [1.2, 0.95], [-1.2, 0.95]], down: [[0, 1.25], [1.2, -0.95], [-1.2, -0.95]],
  cross: [[-0.4, -1.3], [0.4, -1.3], [0.4, -0.4], [1.3, -0.4], [1.3, 0.4], [0.4, 0.4], [0.4, 1.3], [-0.4, 1.3], [-0.4, 0.4], [-1.3, 0.4], [-1.3, -0.4], [-0.4, -0.4]],
};

export function shape(context, kind, x, y, size) {
  context.moveTo(x + size, y);
  if (kind === "circle") context.arc(x, y, size, 0, 2 * Math.PI);
  else if (kind === "square") context.rect(x - size, y - size, 2 * size, 2 * size);
  else {
    const corners = CORNERS[kind];
    context.moveTo(x + corners[0][0] * size, y + corners[0][1] * size);
    for (const [a, b] of corners.slice(1)) context.lineTo(x + a * size, y + b * size);
    context.closePath();
  }
}
