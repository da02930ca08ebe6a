// What the runs determined, what they did not, and the run that would; chosen quantities with prior, posterior and pairs.

import { corner } from "./corner.js";
import { el, fill, minus } from "./dom.js";
import { geometry } from "./geometry.js";
import { ask } from "./net.js";
import { atWork, onChange, show, told, view } from "./state.js";

const MOST = 6;
let known = { model: "", tables: null }, sought = "", found = { key: "", corner: null }, narrowing = { key: "", state: "", runs: null }, drawn = () => {};
const unfolded = new Map();

export function drawKnowledge(panel, actions) {
  drawn = () => view.tab === "knowledge" && drawKnowledge(panel, actions);
  if (known.model !== view.model || !known.tables) {
    fill(panel, el("p", { class: "quiet" }, "…"));
    if (told.facts?.id === view.model && known.model !== view.model) load(actions);
    return;
  }
  const { tables, quantities } = known.tables, names = chosen();
  if (found.key !== keyOf(names)) loadCorner(names, actions);
  const listed = quantities.filter((name) => name.includes(sought)).slice(0, 200);
  fill(panel, el("div", { class: `known ${names.length > 1 ? "cornered" : ""}` },
    el("div", {},
      el("label", {}, "quantity ", el("input", {
        list: "quantities", "data-key": "quantity", value: sought, size: 34, placeholder: "name, such as scale_factor[gx]",
        oninput: (event) => { sought = event.target.value; }, onchange: (event) => pick(event.target.value),
      })), el("datalist", { id: "quantities" }, listed.map((name) => el("option", { value: name }))),
      names.length ? cornerOf(names, actions) : el("p", { class: "quiet" }, "Name a quantity to see its prior and posterior, and up to six to see their pairs."),
      el("h3", { class: "quiet aside" }, "Sensor axes"), geometry(known.tables.frames)),
    el("div", {}, tables.filter((table) => table.rows.length || table.note).map((table, at) => el("details", {
        open: unfolded.get(table.title) ?? at < 2, ontoggle: (event) => unfolded.set(table.title, event.target.open),
      },
      el("summary", {}, table.title, el("span", { class: "quiet" }, ` (${table.rows.length})`)), sheet(table))))));
}

const keyOf = (names) => JSON.stringify([view.model, names]);

// Those of the address that this model has.
function chosen() {
  return view.quantities.filter((name) => known.tables.quantities.includes(name)).slice(-MOST);
}

function pick(name) {
  sought = name;
  if (known.tables.quantities.includes(name)) show({ quantities: [...chosen().filter((each) => each !== name), name].slice(-MOST) });
}

function cornerOf(names, actions) {
  const here = found.key === keyOf(names) && found.corner;
  return [
    el("div", { class: "chips" }, names.map((name) => el("span", { class: "chip" }, name,
      el("button", { class: "plain", "data-key": `drop-${name}`, "aria-label": `remove ${name} from the picture`, onclick: () => show({ quantities: names.filter((each) => each !== name) }) }, "×")))),
    here ? [
      here.quantities.length === 1 && here.quantities[0].written ? prior(here.quantities[0], actions) : null,
      el("figure", {}, el("figcaption", {}, here.quantities.length === 1 ? numbersOf(here.quantities[0]) : "Joint regions contain 50 and 95 % of the draws. ρ: correlation.  ", el("span", { class: "posterior-words" }, "Posterior"), ", ", el("span", { class: "quiet" }, "prior (dashed)"), "."), corner(here)),
      here.quantities.length > 1 ? numbersTable(here.quantities) : null,
      runs(names, actions),
    ].flat() : el("p", { class: "quiet" }, "…"),
  ].flat();
}

function numbersOf({ estimate, sd, unit }) {
  return `${minus(estimate)} ± ${sd} ${unit}. `;
}

function numbersTable(quantities) {
  return el("table", { class: "wide" }, el("thead", {}, el("tr", {}, el("th", { class: "left" }, "name"), el("th", {}, "estimate ± sd"), el("th", { class: "left" }, "unit"), el("th", {}, "from data"))),
    el("tbody", {}, quantities.map((each) => el("tr", {}, el("td", { class: "left" }, each.name), el("td", { "data-label": "estimate" }, `${minus(each.estimate)} ± ${each.sd}`),
      el("td", { class: "left", "data-label": "unit" }, each.unit), el("td", { "data-label": "from data", class: each.weak ? "doubtful" : "" }, each.from_data)))));
}

// The run that would narrow them: ranked when asked for, which takes the worker some seconds the first time.
function runs(names, actions) {
  const own = narrowing.key === keyOf(names) ? narrowing : { state: "", runs: null };
  if (own.runs) {
    const { table, none_for: none } = own.runs;
    return [table.rows.length ? el("div", { id: "narrowing" }, sheet(table)) : null,
      none.length ? el("p", { class: "aside", id: "not-narrowed" }, `No run that the equipment allows would narrow ${none.join(", ")} by a tenth.`) : null];
  }
  return [el("button", { id: "narrow", "data-key": "narrow", disabled: own.state === "waiting", onclick: () => askRuns(names, actions) }, own.state === "waiting" ? "ranking the runs …" : "find the run that would narrow them")];
}

async function askRuns(names, actions) {
  const key = keyOf(names), answer = await actions.attempt(() => ask("runs", { model: view.model, names }));
  narrowing = { key, state: answer === null ? "waiting" : "", runs: answer ?? null, names, actions };
  drawn();
}

// The answer is there when the task is done; one that failed or was cancelled is asked for again by the user.
onChange((_, heard) => {
  if (narrowing.state !== "waiting" || !heard.includes("session")) return;
  const last = told.session.tasks.filter((task) => task.kind === "runs").at(-1);
  if (!last || atWork(last)) return;
  narrowing.state = "";
  if (last.state === "done" && keyOf(narrowing.names) === narrowing.key) askRuns(narrowing.names, narrowing.actions);
  else drawn();
});

function prior(quantity, actions) {
  const text = el("input", { id: "prior", "data-key": "prior", size: 26, value: quantity.written, maxlength: "200" });
  return el("form", { class: "row", onsubmit: (event) => {
    event.preventDefault();
    actions.change({ prior_of: quantity.name, prior: text.value });
  } }, el("label", {}, "prior ", text), el("button", { "data-key": "refit-prior", id: "refit-prior" }, "refit with it"));
}

async function load(actions) {
  known = { model: view.model, tables: null };
  const tables = await actions.attempt(() => ask("known", { model: view.model }));
  known = { model: view.model, tables: tables ?? null };
  if (tables) drawn();
}

async function loadCorner(names, actions) {
  const key = keyOf(names);
  found = { key, corner: null };
  const facts = names.length ? await actions.attempt(() => ask("corner", { model: view.model, names })) : null;
  if (found.key !== key || !facts) return;
  found = { key, corner: facts };
  drawn();
}

function sheet(table) {
  const names = new Set(known.tables.quantities);
  const cell = (text, at, row) => el("td", { class: `${table.left.includes(at) ? "left" : ""} ${table.doubtful.includes(row * table.head.length + at) ? "doubtful" : ""}` },
    at === 0 && names.has(text) ? el("button", { class: "plain", onclick: () => pick(text) }, text) : minus(text));
  return el("div", {}, el("table", {},
    el("thead", {}, el("tr", {}, table.head.map((words, at) => el("th", { class: table.left.includes(at) ? "left" : "" }, words)))),
    el("tbody", {}, table.rows.map((row, place) => el("tr", {}, row.map((text, at) => cell(text, at, place)))))),
    table.note ? el("p", { class: "aside quiet" }, table.note) : null);
}
