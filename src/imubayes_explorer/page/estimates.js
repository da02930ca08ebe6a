// The calibration: every estimate as the command prints it, beside the model before, and where a preview would move it.

import { digits, el, fill, minus } from "./dom.js";
import { ask } from "./net.js";
import { told, view } from "./state.js";

let known = { key: "", found: null }, sought = "";
const LEAST = 0.05;

export function drawEstimates(panel, actions) {
  const key = `${told.facts?.id} ${told.facts?.identity}`;
  if (!told.facts || told.facts.id !== view.model) {
    fill(panel, el("p", { class: "quiet" }, "…"));
    return;
  }
  if (known.key !== key) {
    load(key, panel, actions);
    fill(panel, el("p", { class: "quiet" }, "…"));
    return;
  }
  if (!known.found) return;
  const { lines, before, note } = known.found, preview = told.preview?.effects.length ? told.preview : null;
  const moved = new Map((preview?.moved ?? []).map((each) => [each.name, each]));
  const shift = (line) => (preview ? moved.get(line.name)?.in_sd : line.in_sd) ?? 0;
  const shown = lines.filter((line) => line.name.includes(sought));
  // What moved comes first, that most; all else stays in the order of the tables.
  const first = shown.filter((line) => Math.abs(shift(line)) >= LEAST).sort((one, other) => Math.abs(shift(other)) - Math.abs(shift(one)));
  const rest = shown.filter((line) => !first.includes(line));
  const compared = preview || before;
  const head = ["estimate", "sd", "unit", ...(preview ? [preview.refitted ? "after the refit" : "with the preview", "shift"] : before ? ["before", "shift"] : []), "from data"];
  const row = (line) => el("tr", { class: line.weak ? "quiet" : "" },
    el("td", { class: "left" }, line.name), el("td", { "data-label": "estimate" }, minus(line.estimate)), el("td", { "data-label": "sd" }, line.sd),
    el("td", { class: "left unit", "data-label": "unit" }, line.unit),
    preview ? el("td", { "data-label": "after" }, minus(moved.get(line.name)?.after ?? line.estimate)) : null,
    !preview && before ? el("td", { "data-label": "before" }, line.before ? `${minus(line.before)} ± ${line.before_sd}` : "–") : null,
    compared ? el("td", { "data-label": "shift", class: shift(line) > 0 ? "up" : shift(line) < 0 ? "down" : "" }, shiftWords(line, preview, moved)) : null,
    el("td", { "data-label": "from data" }, line.from_data));
  fill(panel,
    el("div", { class: "row" }, el("label", {}, "names with ", el("input", { "data-key": "sought", id: "sought", value: sought, size: 20, oninput: (event) => { sought = event.target.value; drawEstimates(panel, actions); } })),
      el("span", { class: "quiet" }, `${shown.length} of ${lines.length} estimates${before && !preview ? `; before: ${before}` : ""}${preview && !preview.refitted ? `; preview: ${preview.effects.join(", ")}` : ""}${compared ? "; those that moved most first" : ""}`)),
    el("table", { class: "wide", id: "calibration" },
      el("thead", {}, el("tr", {}, el("th", { class: "left" }, "name"), head.map((words) => el("th", { class: words === "unit" ? "left" : "" }, words)))),
      el("tbody", {}, first.map(row), rest.map(row))),
    el("p", { class: "aside quiet" }, note, compared ? " The shift is given in standard uncertainties; – means less than a twentieth." : ""));
}

function shiftWords(line, preview, moved) {
  const size = preview ? moved.get(line.name)?.in_sd : line.in_sd;
  if (size === undefined || size === null || (Math.abs(size) < LEAST)) return "–";
  return `${size > 0 ? "↑" : "↓"} ${digits(Math.abs(size), 2)} sd`;
}

async function load(key, panel, actions) {
  known = { key, found: null };
  const found = await actions.attempt(() => ask("estimates", { model: view.model }));
  if (known.key !== key) return;
  known = found ? { key, found } : { key: "", found: null };
  if (found && view.tab === "estimates") drawEstimates(panel, actions);
}
