// Elements, numbers and colours; nothing here knows what is shown.

export function el(tag, attributes = {}, ...children) {
  const made = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === undefined || value === false) continue;
    if (name.startsWith("on")) made.addEventListener(name.slice(2), value);
    else if (name === "class") made.className = value;
    else if (name === "style") Object.assign(made.style, value);
    else if (name in made && typeof value !== "string") made[name] = value;
    else made.setAttribute(name, value === true ? "" : value);
  }
  made.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return made;
}

// While a button of the pointer is down nothing is replaced: what is pressed and what is let go are one element.
let pressed = false;
const waiting = new Map();

addEventListener("pointerdown", () => { pressed = true; }, true);
for (const name of ["pointerup", "pointercancel", "blur"]) {
  addEventListener(name, (event) => {
    if (name === "blur" && event.target !== window) return; // of an element, not of the page
    pressed = false;
    setTimeout(() => {
      const late = [...waiting];
      waiting.clear();
      for (const [place, children] of late) fill(place, ...children);
    });
  }, true);
}

// Replaces what is in an element; the focus stays on what has the same data-key.
export function fill(place, ...children) {
  if (pressed) {
    waiting.set(place, children);
    return;
  }
  waiting.delete(place);
  const key = place.contains(document.activeElement) ? document.activeElement.dataset.key : undefined;
  const top = place.scrollTop;
  place.replaceChildren(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  place.scrollTop = top;
  if (key) place.querySelector(`[data-key="${CSS.escape(key)}"]`)?.focus({ preventScroll: true });
}

export function digits(value, count = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size >= 1e7 || size < 1e-5) return minus(value.toExponential(count - 1));
  // Rounded as in the sentences: one quantity has one figure.
  const rounded = Number(value.toPrecision(count)), places = Math.max(0, Math.min(8, count - 1 - Math.floor(Math.log10(Math.abs(rounded)))));
  return minus(rounded.toFixed(places));
}

// Numbers in words from the server have hyphens, as commands need them; on the page a negative number has its sign.
export function minus(text) {
  return text.replace(/(^|[\s(±…[])-(?=[\d.])/g, "$1−");
}

// A ratio in few signs: 0.8, 46, 8.2k, 5.5M.
export function compact(value) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "–";
  if (value < 999.5) return value.toFixed(value < 9.95 ? 1 : 0);
  const [size, sign] = value < 999500 ? [value / 1e3, "k"] : [value / 1e6, "M"];
  return `${size.toFixed(size < 9.95 ? 1 : 0)}${sign}`;
}

// A long name keeps both ends, by which names of runs differ.
export function shortened(name, most) {
  return name.length <= most ? name : `${name.slice(0, Math.ceil((most - 1) / 2))}…${name.slice(name.length - Math.floor((most - 1) / 2))}`;
}

export function probability(value) {
  if (value === null || value === undefined) return "–";
  if (value > 0.999) return "> 0.999";
  if (value < 0.001) return "< 0.001";
  return value >= 0.01 && value < 0.99 ? value.toFixed(2) : value.toFixed(3);
}

/** An integer as an exponent in superscript. */
const raised = (value) => [...value.toFixed(0)].map((sign) => "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"["-0123456789".indexOf(sign)]).join("");

export function odds(value) {
  if (value === null || value === undefined) return "";
  const tens = value / Math.LN10;
  return Math.abs(tens) < 3 ? `odds ${digits(Math.exp(value), 2)} : 1` : `odds 10${raised(tens)} : 1`;
}

export function bar(share, tick = null) {
  const width = `${(100 * Math.max(0, Math.min(1, share))).toFixed(1)}%`;
  const mark = tick === null ? null : el("b", { style: { left: `calc(${(100 * tick).toFixed(1)}% - 1px)` } });
  return el("span", { class: "bar", "aria-hidden": "true" }, el("i", { style: { width } }), mark);
}

// χ²/n from the ground of each theme to its opposite (magma), logarithmic from 1 to the worst cell: what fails stands out.
const MAGMA = {
  light: [[255, 255, 248], [254, 204, 143], [247, 112, 92], [182, 55, 122], [81, 18, 124], [25, 10, 50]],
  dark: [[27, 33, 44], [70, 32, 122], [140, 41, 129], [222, 73, 104], [254, 159, 109], [252, 253, 191]],
};

export function themed() {
  return document.documentElement.dataset.theme === "dark" ? "dark" : "light";
}

export function heat(ratio, worst) {
  const stops = MAGMA[themed()], share = Math.max(0, Math.min(1, Math.log(Math.max(ratio, 1)) / Math.log(Math.max(worst, 10))));
  const at = share * (stops.length - 1), low = Math.min(Math.floor(at), stops.length - 2), part = at - low;
  const [r, g, b] = [0, 1, 2].map((k) => Math.round(stops[low][k] * (1 - part) + stops[low + 1][k] * part));
  const light = 0.2126 * linear(r) + 0.7152 * linear(g) + 0.0722 * linear(b);
  return { back: `rgb(${r} ${g} ${b})`, text: light > 0.18 ? "#000000" : "#ffffff", light };
}

export function heatGround() {
  return `linear-gradient(to right, ${MAGMA[themed()].map((stop) => `rgb(${stop.join(" ")})`).join(", ")})`;
}

function linear(value) {
  const part = value / 255;
  return part <= 0.04045 ? part / 12.92 : ((part + 0.055) / 1.055) ** 2.4;
}

// Labels of equal steps with as many digits as tell them apart.
export function ticks(splits) {
  const known = splits.filter((value) => value !== null), size = Math.max(...known.map(Math.abs), 0);
  const step = known.length > 1 ? Math.abs(known[1] - known[0]) : size;
  const power = size >= 1e6 || (size > 0 && size < 1e-4) ? Math.floor(Math.log10(size)) : 0, scaled = step / 10 ** power;
  let places = Math.max(0, -Math.floor(Math.log10(scaled || 1) + 1e-9));
  while (places < 12 && Math.abs(scaled * 10 ** places - Math.round(scaled * 10 ** places)) > 1e-6 * scaled * 10 ** places) places += 1;
  return splits.map((value) => (value === null ? null : minus(`${(value / 10 ** power).toFixed(places)}${power && value ? `e${power}` : ""}`.replace(/^-(0(\.0*)?)$/, "$1"))));
}

const HUES = {
  light: ["#0072b2", "#d55e00", "#009e73", "#7a3b00", "#8c5fb5", "#6b6b6b"],
  dark: ["#56b4e9", "#ffb347", "#3ddbb0", "#f28ac4", "#f0e442", "#c3c9d3"],
};
const SHAPES = ["circle", "triangle", "square", "diamond", "down", "cross"];

// A hue never stands alone: those next to each other differ in shape as well.
export function sign(place) {
  const hues = HUES[themed()];
  return { colour: hues[place % hues.length], shape: SHAPES[(place + Math.floor(place / hues.length)) % SHAPES.length] };
}

export function css(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}
