// What the runs determined, what they did not, and the run that would; any quantity with its prior and posterior.

import { digits, el, fill, minus } from "./dom.js";
import { geometry } from "./geometry.js";
import { ask } from "./net.js";
import { told, view } from "./state.js";

let known = { model: "", tables: null }, chosen = null, sought = "";
const unfolded = new Map();

export function drawKnowledge(panel, actions) {
  if (known.model !== view.model || !known.tables) {
    fill(panel, el("p", { class: "quiet" }, "…"));
    if (told.facts?.id === view.model && known.model !== view.model) load(panel, actions);
    return;
  }
  const { tables, quantities } = known.tables;
  const found = quantities.filter((name) => name.includes(sought)).slice(0, 200);
  fill(panel, el("div", { class: "known" },
    el("div", {},
      el("label", {}, "quantity ", el("input", {
        list: "quantities", "data-key": "quantity", value: sought, size: 34, placeholder: "name, such as scale_factor[gx]",
        oninput: (event) => { sought = event.target.value; }, onchange: (event) => seek(event.target.value, panel, actions),
      })), el("datalist", { id: "quantities" }, found.map((name) => el("option", { value: name }))),
      chosen ? [chosen.written ? prior(actions) : null, densities(chosen)] : el("p", { class: "quiet" }, "Name a quantity to see its prior and posterior."),
      el("h3", { class: "quiet aside" }, "Sensor axes"), geometry(known.tables.frames)),
    el("div", {}, tables.filter((table) => table.rows.length || table.note).map((table, at) => el("details", {
        open: unfolded.get(table.title) ?? at < 2, ontoggle: (event) => unfolded.set(table.title, event.target.open),
      },
      el("summary", {}, table.title, el("span", { class: "quiet" }, ` (${table.rows.length})`)), sheet(table, panel, actions))))));
}

function prior(actions) {
  const text = el("input", { id: "prior", "data-key": "prior", size: 26, value: chosen.written, maxlength: "200" });
  return el("form", { class: "row", onsubmit: (event) => {
    event.preventDefault();
    actions.change({ prior_of: chosen.name, prior: text.value });
  } }, el("label", {}, "prior ", text), el("button", { "data-key": "refit-prior", id: "refit-prior" }, "refit with it"));
}

async function load(panel, actions) {
  known = { model: view.model, tables: null };
  chosen = null;
  const tables = await actions.attempt(() => ask("known", { model: view.model }));
  known = { model: view.model, tables: tables ?? null };
  if (tables) drawKnowledge(panel, actions);
}

async function seek(name, panel, actions) {
  sought = name;
  if (!known.tables.quantities.includes(name)) return;
  const found = await actions.attempt(() => ask("quantity", { model: view.model, name }));
  if (found) {
    chosen = found;
    drawKnowledge(panel, actions);
  }
}

function sheet(table, panel, actions) {
  const names = new Set(known.tables.quantities);
  const cell = (text, at, row) => el("td", { class: `${table.left.includes(at) ? "left" : ""} ${table.doubtful.includes(row * table.head.length + at) ? "doubtful" : ""}` },
    at === 0 && names.has(text) ? el("button", { class: "plain", onclick: () => seek(text, panel, actions) }, text) : minus(text));
  return el("div", {}, el("table", {},
    el("thead", {}, el("tr", {}, table.head.map((words, at) => el("th", { class: table.left.includes(at) ? "left" : "" }, words)))),
    el("tbody", {}, table.rows.map((row, place) => el("tr", {}, row.map((text, at) => cell(text, at, place)))))),
    table.note ? el("p", { class: "aside quiet" }, table.note) : null);
}

const SVG = "http://www.w3.org/2000/svg", WIDTH = 300, HEIGHT = 96;

function densities(found) {
  const picture = document.createElementNS(SVG, "svg");
  picture.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT + 18}`);
  picture.setAttribute("class", "densities");
  picture.setAttribute("role", "img");
  picture.setAttribute("aria-label", `prior and posterior of ${found.name}`);
  const low = found.x[0], width = found.x.at(-1) - low, at = (x) => (WIDTH * (x - low)) / width;
  for (const [values, name] of [[found.prior, "prior"], [found.posterior, "posterior"]]) {
    const path = document.createElementNS(SVG, "path");
    path.setAttribute("d", `M0 ${HEIGHT}` + found.x.map((x, k) => `L${at(x).toFixed(1)} ${(HEIGHT * (1 - 0.95 * values[k])).toFixed(1)}`).join("") + `L${WIDTH} ${HEIGHT}`);
    path.setAttribute("class", name);
    picture.append(path);
  }
  for (const share of [0.1, 0.5, 0.9]) {
    const words = document.createElementNS(SVG, "text");
    words.setAttribute("x", WIDTH * share);
    words.setAttribute("y", HEIGHT + 13);
    words.textContent = digits(low + share * width, 6);
    picture.append(words);
  }
  return el("figure", {}, el("figcaption", {}, `${found.name} / ${found.unit}: `, el("span", { class: "posterior-words" }, "posterior"), ", ", el("span", { class: "quiet" }, "prior (grey)")), picture);
}
