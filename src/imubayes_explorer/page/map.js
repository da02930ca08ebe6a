// χ² per reading of every run and channel: where the model fails; a cell selects its readings.

import { compact, digits, el, fill, heat, heatGround, shortened, themed } from "./dom.js";
import { show, told, view } from "./state.js";

let fitted = false, drawn = null;

// Cells are made once for a model, and changed in place: of a hundred runs a brush changes the look of a few.
export function drawMap(place) {
  const facts = told.facts;
  if (!facts) {
    drawn = null;
    fill(place);
    return;
  }
  if (drawn?.facts !== facts || !place.contains(drawn.table)) build(place, facts);
  const expected = told.preview?.effects.length ? told.preview.cells : null;
  const look = [expected, fitted, themed()];
  if (!drawn.look.length || look.some((each, at) => each !== drawn.look[at])) {
    // The scale is that of the model, not of a preview: what a preview takes off is seen as a change of colour.
    const worst = Math.max(10, ...facts.cells.filter((cell) => cell.n).map((cell) => chi2Of(cell) / cell.n));
    drawn.cells.forEach(([cell, button], at) => paint(cell, button, expected ? expected[at] : null, worst));
    fill(drawn.scale, legend(worst));
    fill(drawn.note, expected ? (told.preview.refitted ? "χ² of the refit." : "Dashed: expected with the preview.") : "Noise alone gives 1. Click a cell, a run or a channel to select it; hold ⇧ to add.");
    drawn.look = look;
  }
  drawn.cells.forEach(mark);
}

function build(place, facts) {
  const buttons = facts.cells.map((cell) => el("button", { "data-key": `cell-${cell.run}-${cell.channel}`, onclick: (event) => choose(cell, event.shiftKey) }));
  const known = new Map(facts.cells.map((cell, at) => [JSON.stringify([cell.run, cell.channel]), buttons[at]]));
  const head = el("tr", {}, el("th", { class: "run" }, "run"), facts.channels.map((channel) => el("th", {},
    el("button", { "data-key": `channel-${channel}`, onclick: () => show({ channel, brushes: [{ channels: [channel], runs: [] }] }), title: `select channel ${channel}` }, channel))));
  const rows = facts.runs.map((run) => el("tr", {},
    el("th", { class: "run" }, el("button", { "data-key": `run-${run}`, title: `select run ${run}`, onclick: () => show({ brushes: [{ channels: [], runs: [run] }] }) }, shortened(run, facts.runs.length > 24 ? 12 : 18))),
    facts.channels.map((channel) => el("td", {}, known.get(JSON.stringify([run, channel])) ?? null))));
  const table = el("table", { onkeydown: walk }, el("thead", {}, head), el("tbody", {}, rows)), scale = el("div"), note = el("p", { class: "aside quiet" });
  drawn = { facts, table, scale, note, look: [], cells: facts.cells.map((cell, at) => [cell, buttons[at]]) };
  fill(place,
    el("div", { class: "head" }, el("h2", { id: "map-title" }, "χ² per reading"),
      el("label", { class: "quiet" }, el("input", { type: "checkbox", "data-key": "fitted", checked: fitted, onchange: (event) => { fitted = event.target.checked; drawMap(place); } }), " at fitted noise")),
    scale, table, note);
}

function chi2Of(cell) {
  return fitted ? cell.fitted ?? cell.chi2 : cell.chi2;
}

// Decades of the scale, as many as there is room for.
function legend(worst) {
  const most = Math.log10(worst), step = Math.ceil(most / 4), marks = [];
  for (let power = 0; power <= 0.85 * most; power += step) marks.push([power, power ? compact(10 ** power) : "≤ 1"]);
  marks.push([most, compact(worst)]);
  return el("div", { class: "scale", id: "scale", role: "img", "aria-label": `Colours: χ² per reading, logarithmic from 1 to ${compact(worst)}, that of the worst cell` },
    el("i", { style: { background: heatGround() } }), marks.map(([power, words]) => el("span", { style: { left: `${(100 * power) / most}%` } }, words)));
}

function paint(cell, button, expected, worst) {
  const { n, chi2 } = expected ?? { n: cell.n, chi2: chi2Of(cell) };
  // Nothing is left of a cell whose readings are all set aside.
  const { back = "", text = "" } = n ? heat(chi2 / n, worst) : {}, words = n ? compact(chi2 / n) : "–";
  button.className = ["cell", expected !== null && (told.preview.refitted ? "refitted" : "previewed")].filter(Boolean).join(" ");
  Object.assign(button.style, { backgroundColor: back, color: text });
  button.textContent = words;
  button.title = `${cell.run} ${cell.channel}: χ² ${digits(cell.chi2, 4)} of ${cell.n}, ${digits(cell.rms)} ${cell.unit} rms`
    + (expected === null ? "" : `; ${told.preview.refitted ? "now" : "expected"} χ² ${digits(expected.chi2, 4)} of ${expected.n}`);
  button.setAttribute("aria-label", `${words}: χ² per reading of run ${cell.run}, channel ${cell.channel}`);
}

function mark([cell, button]) {
  const marked = view.brushes.some((brush) => !brush.x && !brush.rows?.length && matches(brush.channels, cell.channel) && matches(brush.runs, cell.run));
  button.classList.toggle("marked", marked);
  button.classList.toggle("shown", cell.channel === view.channel);
  button.setAttribute("aria-pressed", String(marked));
}

function matches(names, name) {
  return !names.length || names.includes(name);
}

function choose(cell, added) {
  const brush = { channels: [cell.channel], runs: [cell.run] };
  show({ channel: cell.channel, brushes: added ? [...view.brushes, brush] : [brush] });
}

// Arrows walk from cell to cell.
function walk(event) {
  const here = event.target.closest("td, th"), ways = { ArrowUp: [-1, 0], ArrowDown: [1, 0], ArrowLeft: [0, -1], ArrowRight: [0, 1] };
  if (!here || !(event.key in ways)) return;
  event.preventDefault();
  const [down, right] = ways[event.key], rows = [...event.currentTarget.querySelectorAll("tr")];
  let row = rows.indexOf(here.parentElement), column = here.cellIndex;
  for (;;) {
    row += down;
    column += right;
    const next = rows[row]?.cells[column];
    if (!next) return;
    const button = next.querySelector("button");
    if (button) {
      button.focus();
      return;
    }
  }
}
