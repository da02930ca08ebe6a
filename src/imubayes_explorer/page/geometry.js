// Sensor axes as designed and as fitted, with their 95 % cones, in a picture that is turned by mouse and by keyboard.

import { digits, el, fill } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg", SIZE = 320, RADIUS = 112, STEP = Math.PI / 36, AROUND = 40;
const START = { yaw: 0.62, pitch: 0.42 };
let turn = { ...START }, frame = "body", louder = 1;

const add = (a, b, k = 1) => a.map((value, n) => value + k * b[n]);
const unit = (a) => a.map((value) => value / Math.hypot(...a));

// Orthographic: x to the right and towards the eye, z up; the third number is the depth.
function project([x, y, z]) {
  const [cy, sy, cp, sp] = [Math.cos(turn.yaw), Math.sin(turn.yaw), Math.cos(turn.pitch), Math.sin(turn.pitch)];
  const across = -sy * x + cy * y, towards = cy * x + sy * y;
  return [SIZE / 2 + RADIUS * across, SIZE / 2 - RADIUS * (cp * z - sp * towards), cp * towards + sp * z];
}

function shape(tag, attributes, words) {
  const made = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) made.setAttribute(name, value);
  if (words) made.textContent = words;
  return made;
}

const path = (points, closed = false) => points.map(([x, y], n) => `${n ? "L" : "M"}${x.toFixed(1)} ${y.toFixed(1)}`).join("") + (closed ? "Z" : "");

// The largest of 1, 2, 5 × 10ⁿ with which no tilt and no cone is drawn above 20°.
function exaggeration(axes) {
  const largest = Math.max(1e-9, ...axes.flatMap((axis) => [axis.tilt, axis.cone])) / 206265;
  const whole = Math.max(1, 0.35 / largest), power = 10 ** Math.floor(Math.log10(whole));
  return power * [5, 2, 1].find((step) => step * power <= whole);
}

function drawnAxis(axis, factor) {
  const fitted = unit(add(axis.nominal, add(axis.fitted, axis.nominal, -1), factor));
  const rim = Array.from({ length: AROUND }, (_, n) => {
    const angle = (2 * Math.PI * n) / AROUND;
    return project(unit(add(add(fitted, axis.along, factor * Math.cos(angle)), axis.across, factor * Math.sin(angle))));
  });
  const tip = project(fitted), end = project(axis.nominal), centre = project([0, 0, 0]), words = project(add([0, 0, 0], fitted, 1.14));
  const behind = tip[2] < 0 ? " behind" : "";
  return { depth: tip[2], parts: [
    shape("path", { class: "nominal", d: path([centre, end]) }),
    ...rim.filter((_, n) => n % 5 === 0).map((point) => shape("path", { class: `mantle${behind}`, d: path([centre, point]) })),
    shape("path", { class: `cone${behind}`, d: path(rim, true) }),
    shape("path", { class: `fitted${behind}`, d: path([centre, tip]) }),
    shape("text", { x: words[0].toFixed(1), y: (words[1] + 4).toFixed(1) }, axis.channel),
  ] };
}

function said(found, factor) {
  const each = found.axes.map((axis) => `${axis.channel} is tilted by ${digits(axis.tilt, 3)} arcsec, 95 % cone ${digits(axis.cone, 2)} arcsec`);
  return `Sensor axes in ${found.name === "body" ? "body axes" : `mounting ${found.name}`}; tilts and cones are drawn ${factor} times as large. ${each.join("; ")}.`;
}

function paint(picture, found) {
  const factor = exaggeration(found.axes) * louder, names = found.name === "body" ? ["x", "y", "z"] : ["x table", "y table", "z table"];
  const frameAxes = [[1, 0, 0], [0, 1, 0], [0, 0, 1]].flatMap((axis, n) => {
    const tip = project(add([0, 0, 0], axis, 1.3));
    return [shape("path", { class: "frame", d: path([project([0, 0, 0]), tip]) }), shape("text", { class: "frame", x: tip[0].toFixed(1), y: tip[1].toFixed(1) }, names[n])];
  });
  const ring = Array.from({ length: 61 }, (_, n) => project([Math.cos((n * Math.PI) / 30), Math.sin((n * Math.PI) / 30), 0]));
  const corners = [[1, 1, 1], [1, -1, 1], [-1, -1, 1], [-1, 1, 1], [1, 1, -1], [1, -1, -1], [-1, -1, -1], [-1, 1, -1]]
    .map((signs) => project(found.body.reduce((sum, axis, n) => add(sum, axis, 0.22 * signs[n]), [0, 0, 0])));
  const edges = [[0, 1], [1, 2], [2, 3], [3, 0], [4, 5], [5, 6], [6, 7], [7, 4], [0, 4], [1, 5], [2, 6], [3, 7]];
  const axes = found.axes.map((axis) => drawnAxis(axis, factor)).sort((one, other) => one.depth - other.depth);
  picture.replaceChildren(shape("path", { class: "plane", d: path(ring, true) }), ...frameAxes,
    ...edges.map(([a, b]) => shape("path", { class: "case", d: path([corners[a], corners[b]]) })), ...axes.flatMap((axis) => axis.parts));
  picture.setAttribute("aria-label", `${said(found, factor)} Arrow keys turn the picture, plus and minus change the exaggeration, 0 resets both.`);
  return factor;
}

const KEYS = {
  ArrowLeft: () => { turn.yaw -= STEP; }, ArrowRight: () => { turn.yaw += STEP; }, ArrowUp: () => { turn.pitch += STEP; }, ArrowDown: () => { turn.pitch -= STEP; },
  "+": () => { louder *= 2; }, "-": () => { louder /= 2; }, 0: () => { turn = { ...START }; louder = 1; },
};

export function geometry(frames) {
  const picture = shape("svg", { viewBox: `12 6 ${SIZE - 24} ${SIZE - 30}`, class: "geometry", id: "geometry", role: "img", tabindex: "0" });
  const words = el("figcaption", { "aria-live": "polite" }), rows = el("tbody"), place = el("figure", { class: "geometry-figure" });
  const draw = () => {
    const found = frames.find((each) => each.name === frame) ?? frames[0], factor = paint(picture, found);
    fill(words, `Dashed: as designed; solid: as fitted, with its 95 % cone. Tilts and cones are drawn ${factor} times as large. Drag, or use arrow keys.`);
    fill(rows, found.axes.map((axis) => el("tr", {}, el("td", { class: "left" }, axis.channel), el("td", {}, digits(axis.tilt, 4)), el("td", {}, digits(axis.cone, 2)))));
  };
  picture.addEventListener("keydown", (event) => {
    if (!Object.hasOwn(KEYS, event.key) || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    event.stopPropagation();
    KEYS[event.key]();
    draw();
  });
  picture.addEventListener("pointerdown", (event) => picture.setPointerCapture(event.pointerId));
  picture.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    turn = { yaw: turn.yaw - event.movementX / 90, pitch: Math.max(-1.5, Math.min(1.5, turn.pitch + event.movementY / 90)) };
    draw();
  });
  const pick = el("label", {}, "axes in ", el("select", { id: "geometry-frame", "data-key": "geometry-frame", onchange: (event) => { frame = event.target.value; draw(); } },
    frames.map((each) => el("option", { value: each.name, selected: each.name === frame }, each.name === "body" ? "body axes" : `mounting ${each.name}`))));
  place.append(pick, picture, words, el("table", {}, el("thead", {}, el("tr", {}, el("th", { class: "left" }, "axis"), el("th", {}, "tilt / arcsec"), el("th", {}, "95 % cone / arcsec"))), rows));
  draw();
  return place;
}
