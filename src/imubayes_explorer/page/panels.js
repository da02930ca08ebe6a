// Measurement with model above, residuals below: the same points, colours and selection in both.

import { Beside } from "./beside.js";
import { Chart, extent } from "./chart.js";
import { css, el, fill, sign } from "./dom.js";
import { drawLegend } from "./legend.js";
import { byGroup, dashes, drawBand, drawPoints, quantile } from "./marks.js";
import { hideReading, pickReading, tellReading } from "./points.js";
import { asPng, asSvg } from "./picture.js";
import { show, told, view } from "./state.js";

let measurement, residuals, beside, moving = null, whole = null;

export function makeCharts(place, actions) {
  const controls = el("div", { class: "controls", id: "controls" });
  const above = el("div", { class: "chart", id: "measurement", role: "img", "aria-label": "Measurement and model" });
  const below = el("div", { class: "chart", id: "residuals", role: "img", "aria-label": "Residuals" });
  const shared = (panel) => ({ onBrush: brushed, onZoom: zoomed, onPick: (k, added) => pickReading(actions, k, added), onPoint: (k, left, top) => tellReading(actions, panel, k, left, top) });
  beside = new Beside(shared);
  place.append(controls, above, el("div", { class: "pair", id: "pair" }, beside.place, below), el("div", { class: "legend", id: "legend", role: "group", tabindex: "0", "aria-label": "Colours" }));
  measurement = new Chart(above, { ...shared(above), both: false, draw: drawMeasurement, places: () => told.points && { x: told.points.x, y: told.points.observed } });
  residuals = new Chart(below, { ...shared(below), both: true, draw: drawResiduals, places: () => told.points && { x: told.points.x, y: afterShown() ? told.points.after : told.points.y } });
  above.append(el("div", { class: "title" }, "measurement (points) and model (line)"));
  below.append(el("div", { class: "title", id: "residual-title" }));
}

export async function picture(kind) {
  const charts = beside.shown ? [measurement, beside.chart, residuals] : [measurement, residuals];
  return kind === "svg" ? asSvg(charts) : asPng(charts);
}

export function restyle() {
  measurement.build();
  residuals.build();
  beside.build();
  drawCharts();
}

// Zoomed out beyond all readings, the panels show all of them.
function zoomed([low, high]) {
  hideReading();
  const all = whole?.of === `${view.model} ${view.channel} ${view.x}` ? whole.x : null;
  if (all && low <= all[0] && high >= all[1]) show({ between: null }, true);
  else show({ between: [all ? Math.max(low, all[0]) : low, all ? Math.min(high, all[1]) : high] }, true);
  drawCharts(); // those that are here at once, all of the range when they have come
}

export function previewing() {
  return told.preview?.effects.length > 0 && !told.points?.head.refitted;
}

function afterShown() {
  return previewing() && view.after;
}

function brushed({ x, y }, added) {
  const factor = told.points?.head.y_factor ?? 1;
  const brush = { channels: [view.channel], runs: view.only, x: view.x, x_low: x[0], x_high: x[1] };
  if (y !== null) Object.assign(brush, { y: view.y, y_low: y[0] / factor, y_high: y[1] / factor });
  show({ brushes: added ? [...view.brushes, brush] : [brush] });
}

export function drawControls(actions) {
  const facts = told.facts;
  if (!facts) return;
  const pick = (name, label, options) => el("label", {}, label, el("select", {
    "data-key": name, id: `pick-${name}`, onchange: (event) => show({ [name]: event.target.value, ...(name === "x" ? { between: null, brushes: [] } : {}) }),
  }, options.map(([value, words]) => el("option", { value, selected: value === view[name] }, words))));
  fill(document.getElementById("controls"),
    pick("channel", "channel", facts.channels.map((name) => [name, name])),
    pick("x", "against", facts.abscissae.map((axis) => [axis.name, axis.unit ? `${axis.phrase} / ${axis.unit}` : axis.phrase])),
    pick("y", "residual", [["known", "over known noise"], ["input", "in input units"], ["fitted", "over fitted noise"]]),
    pick("colour", "colour", facts.labels.map(({ by }) => [by, by])),
    view.only.length || told.selection?.n ? el("label", {}, el("input", { type: "checkbox", "data-key": "only", checked: view.only.length > 0, onchange: focusRuns }), "only selected runs") : null,
    el("label", {}, el("input", { type: "checkbox", "data-key": "after", checked: view.after, title: "the residual after the preview; key p", onchange: (event) => show({ after: event.target.checked }) }), "after preview"),
    el("label", {}, el("input", { type: "checkbox", "data-key": "beside", id: "side-by-side", checked: view.beside, title: "the residuals of the previous model, or with the preview, on the same axes; key b", onchange: (event) => show({ beside: event.target.checked }) }), "side by side"),
    el("button", { "data-key": "draw", id: "draw", title: "draw the shape that you see, and get its formula; key w", onclick: actions.draw }, "draw a shape"),
    view.between ? el("button", { onclick: () => show({ between: null }) }, "whole range") : null,
    ["svg", "png"].map((kind) => el("button", { class: "plain quiet", "data-key": kind, id: `picture-${kind}`, title: `the panels as ${kind.toUpperCase()}, key ${kind === "svg" ? "g" : "G"}`, onclick: () => actions.picture(kind) }, kind.toUpperCase())));
}

// A shape is drawn over the residuals: points by dragging, or with arrow keys, the space bar and Enter.
export function drawShape(done) {
  const { over } = residuals.plot, sheet = el("div", { class: "drawing", id: "drawing", tabindex: "0", role: "application",
    "aria-label": "Draw a shape over the residuals: drag, or move with the arrow keys, set points with the space bar, end with Enter; Escape cancels." });
  const line = document.createElementNS("http://www.w3.org/2000/svg", "svg"), way = document.createElementNS("http://www.w3.org/2000/svg", "path");
  const width = over.clientWidth, height = over.clientHeight, points = [];
  let at = [0, height / 2];
  line.append(way);
  sheet.append(line, el("p", { class: "hint" }, "Drag along the shape that you see; Escape cancels."));
  const draw = () => way.setAttribute("d", `${[...points].sort((one, other) => one[0] - other[0]).map(([x, y], n) => `${n ? "L" : "M"}${x} ${y}`).join("")}M${at[0] - 5} ${at[1]}h10m-5 -5v10`);
  const end = () => {
    sheet.remove();
    const over = points.map(([x, y]) => [residuals.plot.posToVal(x, "x"), residuals.plot.posToVal(y, "y")]);
    if (over.length > 1) done({ over: view.x, points: over });
  };
  const put = (event) => {
    const box = sheet.getBoundingClientRect();
    at = [event.clientX - box.left, event.clientY - box.top];
    if (!points.some(([x]) => Math.abs(x - at[0]) < width / 60)) points.push(at);
    draw();
  };
  sheet.addEventListener("pointerdown", (event) => { sheet.setPointerCapture(event.pointerId); put(event); });
  sheet.addEventListener("pointermove", (event) => event.buttons && put(event));
  sheet.addEventListener("pointerup", end);
  sheet.addEventListener("keydown", (event) => {
    const moves = { ArrowLeft: [-width / 20, 0], ArrowRight: [width / 20, 0], ArrowUp: [0, -height / 20], ArrowDown: [0, height / 20] }, move = moves[event.key];
    if (event.key !== "Tab") event.stopPropagation();
    if (move) at = [Math.min(width, Math.max(0, at[0] + move[0])), Math.min(height, Math.max(0, at[1] + move[1]))];
    else if (event.key === " ") points.push(at);
    else if (event.key === "Enter") end();
    else if (event.key === "Escape") sheet.remove();
    if (move || event.key === " ") { event.preventDefault(); draw(); }
  });
  over.append(sheet);
  sheet.focus();
  draw();
}

export function focusRuns() {
  show({ only: view.only.length ? [] : told.selection?.runs ?? [] });
}

export function zoomToSelection() {
  const own = view.brushes.filter((brush) => brush.x === view.x);
  if (own.length) show({ between: [Math.min(...own.map((b) => b.x_low)), Math.max(...own.map((b) => b.x_high))] });
}

// From one model to the next the points move: what each step took off is seen.
export function drawCharts(before = null) {
  const points = told.points;
  if (!points) return;
  const { head } = points, last = before && before.head.count === head.count ? before : null;
  if (!view.between) whole = { of: `${view.model} ${view.channel} ${view.x}`, x: extent(points.x) };
  const x = view.between ?? extent(points.x), sd = quantile(points.sd, 0.5);
  const other = beside.points(previewing()), y = extent(other ? [...points.y, ...other.y] : points.y, 1.15 * sd), was = last ? extent(last.y, 1.15 * sd) : y;
  measurement.show({ x, y: extent(points.observed) }, "", head.output_label);
  beside.show(other, { x, y }, head);
  document.getElementById("residual-title").textContent = view.beside ? `residual ${head.refitted ? "of the refit" : "of this model"}` : head.refitted ? "residual of the refit; band: 95 % of noise alone" : told.preview?.effects.length
    ? `residual, and the part that ${told.preview.effects.length > 2 ? `the ${told.preview.effects.length} causes previewed` : told.preview.effects.join(" and ")} would explain` : "residual; band: 95 % of noise alone";
  document.getElementById("residuals").setAttribute("aria-label",
    `Residuals of ${view.channel}: ${head.of} readings. ${told.selection?.sentence ?? ""} Left and right arrows move a selection.`);
  const still = matchMedia("(prefers-reduced-motion: reduce)").matches;
  if (!last || still) {
    moving = null;
    residuals.show({ x, y }, head.x_label, head.y_label);
  } else move(last, points, x, was, y);
  drawLegend(head.groups);
}

function move(last, points, x, was, y) {
  const began = performance.now(), own = {};
  moving = own;
  const step = (now) => {
    if (moving !== own) return;
    const share = Math.min(1, (now - began) / 700), eased = share * share * (3 - 2 * share);
    own.y = points.y.map((value, k) => last.y[k] + eased * (value - last.y[k]));
    residuals.show({ x, y: [0, 1].map((k) => was[k] + eased * (y[k] - was[k])) }, points.head.x_label, points.head.y_label);
    if (share < 1) requestAnimationFrame(step);
    else moving = null;
  };
  requestAnimationFrame(step);
}

function drawMeasurement(context, at) {
  const points = told.points;
  if (!points) return;
  context.lineWidth = 1.2 * at.ratio;
  byGroup(points).forEach((members, place) => {
    if (!members.length) return;
    context.fillStyle = css("--band");
    context.beginPath();
    members.forEach((k, n) => context[n ? "lineTo" : "moveTo"](at.x(points.x[k]), at.y(points.predicted[k] + points.band[k])));
    [...members].reverse().forEach((k) => context.lineTo(at.x(points.x[k]), at.y(points.predicted[k] - points.band[k])));
    context.fill();
    context.strokeStyle = sign(place).colour;
    context.beginPath();
    members.forEach((k, n) => context[n ? "lineTo" : "moveTo"](at.x(points.x[k]), at.y(points.predicted[k])));
    context.stroke();
  });
  if (told.preview?.effects.length && !points.head.refitted) dashes(context, at, points, points.curve);
  drawPoints(context, at, points, points.observed, false);
}

function drawResiduals(context, at) {
  const points = told.points;
  if (!points) return;
  drawBand(context, at, points);
  if (afterShown()) {
    drawPoints(context, at, points, points.after, false);
    return;
  }
  drawPoints(context, at, points, moving?.y ?? points.y, previewing());
  if (previewing()) dashes(context, at, points, points.y.map((value, k) => value - points.after[k]));
}

