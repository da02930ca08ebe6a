// The panels as a picture: PNG of their canvases, or SVG, for which what is drawn on a canvas is written down instead.

import { css } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg", FONT = 11;
const short = (value) => +value.toFixed(2);

function element(name, attributes, words) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (words !== undefined) made.textContent = words;
  return made;
}

// The part of a canvas' context that panels use.
class Written {
  constructor(group) { Object.assign(this, { group, path: "", globalAlpha: 1, lineWidth: 1, fillStyle: "#000", strokeStyle: "#000" }); }
  beginPath() { this.path = ""; }
  moveTo(x, y) { this.path += `M${short(x)} ${short(y)}`; }
  lineTo(x, y) { this.path += `L${short(x)} ${short(y)}`; }
  closePath() { this.path += "Z"; }
  rect(x, y, width, height) { this.path += `M${short(x)} ${short(y)}h${short(width)}v${short(height)}h${short(-width)}Z`; }
  arc(x, y, size) { for (const way of [2, -2]) this.path += `${way > 0 ? `M${short(x - size)} ${short(y)}` : ""}a${short(size)} ${short(size)} 0 0 0 ${short(way * size)} 0`; }
  fill() { this.write({ fill: this.fillStyle }); }
  stroke() { this.write({ fill: "none", stroke: this.strokeStyle, "stroke-width": short(this.lineWidth) }); }
  fillRect(x, y, width, height) {
    this.beginPath();
    this.rect(x, y, width, height);
    this.fill();
  }
  write(style) { if (this.path) this.group.append(element("path", { d: this.path, opacity: this.globalAlpha, ...style })); }
}

function axis(chart, ratio, group) {
  const { plot } = chart, { left, top, width, height } = plot.bbox, quiet = { fill: css("--quiet"), "font-size": FONT * ratio };
  plot.axes.forEach(({ _splits, _values }, at) => (_splits ?? []).forEach((split, n) => {
    const across = at === 0 ? short(plot.valToPos(split, "x", true)) : left - 6 * ratio, down = at === 0 ? top + height + 16 * ratio : short(plot.valToPos(split, "y", true)) + 4 * ratio;
    group.append(element("text", { ...quiet, x: across, y: down, "text-anchor": at === 0 ? "middle" : "end" }, _values[n] ?? ""));
  }));
  group.append(element("rect", { x: left, y: top, width, height, fill: "none", stroke: css("--line") }),
    element("text", { ...quiet, x: left + width / 2, y: top + height + 32 * ratio, "text-anchor": "middle" }, chart.xLabel),
    element("text", { ...quiet, transform: `translate(${left - 62 * ratio} ${top + height / 2}) rotate(-90)`, "text-anchor": "middle" }, chart.yLabel));
}

export function asSvg(charts) {
  const canvases = charts.map((chart) => chart.plot.ctx.canvas), ratio = devicePixelRatio || 1;
  const width = Math.max(...canvases.map((each) => each.width)), height = canvases.reduce((sum, each) => sum + each.height, 0);
  const picture = element("svg", { xmlns: SVG, viewBox: `0 0 ${width} ${height}`, width: width / ratio, height: height / ratio, "font-family": "system-ui, sans-serif" });
  picture.append(element("rect", { width, height, fill: css("--panel") }));
  let top = 0;
  charts.forEach((chart, at) => {
    const group = element("g", { transform: `translate(0 ${top})` }), { left, top: high, width: wide, height: tall } = chart.plot.bbox, clip = element("clipPath", { id: `clip-${at}` });
    clip.append(element("rect", { x: left, y: high, width: wide, height: tall }));
    const inside = element("g", { "clip-path": `url(#clip-${at})` });
    chart.paintOn(new Written(inside));
    group.append(clip, inside);
    axis(chart, ratio, group);
    picture.append(group);
    top += canvases[at].height;
  });
  return new Blob([new XMLSerializer().serializeToString(picture)], { type: "image/svg+xml" });
}

export function asPng(charts) {
  const canvases = charts.map((chart) => chart.plot.ctx.canvas), whole = document.createElement("canvas");
  whole.width = Math.max(...canvases.map((each) => each.width));
  whole.height = canvases.reduce((sum, each) => sum + each.height, 0);
  const context = whole.getContext("2d");
  context.fillStyle = css("--panel");
  context.fillRect(0, 0, whole.width, whole.height);
  canvases.reduce((top, each) => (context.drawImage(each, 0, top), top + each.height), 0);
  return new Promise((done) => whole.toBlob(done, "image/png"));
}
