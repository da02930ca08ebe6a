// Ranked causes: of everything by the one evidence, or of the selected readings; ticked ones are previewed, then added.

import { bar, digits, el, fill, minus, odds, probability } from "./dom.js";
import { kept } from "./offline.js";
import { atWork, show, tell, told, view } from "./state.js";

const MOST = 14;
let every = false, hovering = 0;

export function drawCauses(place, actions) {
  const facts = told.facts;
  if (!facts) {
    fill(place);
    return;
  }
  const chosen = view.brushes.length ? told.selection : null, ready = facts.stage === "ready";
  // A saved page knows what is selected, and cannot rank it.
  const selection = chosen?.n && chosen.nothing !== null ? chosen : null;
  const known = new Map(facts.causes.map((cause) => [cause.effect, cause]));
  const listed = selection ? selection.causes.filter((each) => known.has(each.effect)) : facts.causes;
  const ticked = view.ticked.filter((effect) => known.has(effect) && !listed.some((each) => each.effect === effect));
  const shown = every ? listed : listed.slice(0, MOST);
  const missing = ticked.map((effect) => ({ effect, probability: known.get(effect).probability, log_odds: null }));
  const lines = grouped([...shown, ...missing.filter((each) => !shown.some((one) => one.effect === each.effect))], known, selection, actions);
  fill(place,
    el("div", { class: "head" },
      el("h2", { id: "causes-title" }, selection ? "Causes of these readings" : "Causes of the residual"),
      chosen ? el("span", { class: "row" },
        chosen.n ? el("button", { id: "aside", "data-key": "aside", onclick: actions.aside, title: "key s: fit without these readings, with a reason" }, "set aside …") : null,
        el("button", { onclick: () => show({ brushes: [] }), "data-key": "clear" }, "clear selection")) : null),
    chosen ? el("p", { class: "aside", id: "selection-sentence", role: "status" }, minus(chosen.sentence)) : null,
    selection ? other("noise alone", selection.nothing) : null,
    selection && selection.offset !== null ? other("an offset of these readings alone", selection.offset) : null,
    selection && selection.form !== null ? other(selection.form_words || "outside the catalogue", selection.form) : null,
    ready ? null : weighing(facts),
    ready ? null : el("div", { id: "so-far" }, soFar()),
    lines,
    listed.length > MOST ? el("button", { class: "plain", onclick: () => { every = !every; drawCauses(place, actions); } }, every ? "fewer" : `${listed.length - MOST} more`) : null,
    selection ? el("p", { class: "aside quiet" }, "Each cause is judged by its prediction of these readings from all others. The mark on the bar is the probability from all readings.") : null,
    accept(actions, selection));
}

function weighing(facts) {
  if (kept) return el("p", { class: "aside quiet" }, "The page was saved before the explanations of this model were weighed.");
  return el("p", { class: "aside quiet", id: "weighing", role: "status" }, el("progress", { "aria-label": "weighing" }), " ", el("span", { id: "weighing-step" }, told.weighing || "waiting"), ". ",
    facts.stage === "read" ? "Map and residuals can be used before the causes are ready." : "The diagnosis is available; previews and selections follow shortly.");
}

export function tellWeighing() {
  const step = document.getElementById("weighing-step");
  if (step) step.textContent = told.weighing || "waiting";
}

// By thousandths, then by name: what differs by less would change places at every step.
const bySize = (one, other) => Math.round(1000 * other.probability) - Math.round(1000 * one.probability) || one.effect.localeCompare(other.effect);

// Causes of the search at work: they come one by one, and their probabilities change until all are weighed.
function soFar() {
  const found = told.facts?.stage === "read" && told.facts.id === view.model ? told.soFar : null;
  return found ? [
    el("p", { class: "aside quiet" }, `In ${found.hypotheses} explanations weighed so far, with probabilities that still change:`),
    [...found.inclusion].sort(bySize).slice(0, MOST).map((each) => el("div", { class: "cause" }, el("span"), el("span", { class: "name" }, broken(each.effect)), bar(each.probability), el("span", { class: "number" }, probability(each.probability)))),
  ].flat() : [];
}

export function drawSoFar() {
  const place = document.getElementById("so-far");
  if (place) fill(place, ...soFar());
}

function other(words, share) {
  return el("div", { class: "cause other" }, el("span"), el("span", { class: "name" }, words), bar(share), el("span", { class: "number" }, probability(share)));
}

// Members of a group stand together, with the run that would tell them apart.
function grouped(lines, known, selection, actions) {
  const found = [], groups = new Map();
  for (const line of lines) {
    const cause = known.get(line.effect), row = causeRow(line, cause, selection, actions);
    const members = cause.group === null ? 0 : [...known.values()].filter((each) => each.group === cause.group).length;
    if (members < 2 || selection) {
      found.push(row);
      continue;
    }
    if (!groups.has(cause.group)) {
      const box = el("div", { class: "effect-group" });
      groups.set(cause.group, box);
      found.push(box);
    }
    groups.get(cause.group).append(row);
  }
  for (const [group, box] of groups) {
    const run = told.facts.separating[group - 1];
    box.append(el("p", { class: "aside quiet" }, `These runs cannot distinguish them.${run ? ` A run that would: ${run}.` : ""}`));
  }
  return found;
}

function causeRow(line, cause, selection, actions) {
  const lock = told.session?.locks[cause.effect] ?? "", at = view.ticked.includes(cause.effect);
  const toggle = () => show({ ticked: at ? view.ticked.filter((each) => each !== cause.effect) : [...view.ticked, cause.effect] });
  const next = { "": "in", in: "out", out: "" }[lock], signs = { "": "free", in: "in", out: "out" };
  const id = `tick-${cause.effect}`;
  return el("div", { class: `cause ${lock} ${told.hovered === cause.effect ? "hovered" : ""}`, title: cause.words, onmouseenter: () => hover(cause.effect), onmouseleave: () => hover("") },
    el("input", { type: "checkbox", id, checked: at, disabled: lock === "out" || told.facts.stage !== "ready", "data-key": id, class: "tick", onchange: toggle, onfocus: () => hover(cause.effect), onblur: () => hover("") }),
    el("label", { class: "name", for: id }, broken(cause.effect)),
    bar(line.probability, selection ? cause.probability : null),
    el("span", { class: "number", title: odds(line.log_odds ?? cause.log_odds) }, probability(line.probability)),
    el("span", { class: "more" }, el("span", {}, `${minus(cause.coefficient)}; Δχ² ${digits(cause.delta_chi2)}; ${odds(cause.log_odds)} alone`),
      el("button", { class: "plain quiet", "data-key": `lock-${cause.effect}`, title: `locked: ${signs[lock]}; in: always added, out: never proposed`, "aria-label": `lock of ${cause.effect}: ${signs[lock]}`, onclick: () => actions.lock(cause.effect, next) }, signs[lock])));
}

// A long name breaks at an underscore.
function broken(name) {
  return name.split(/(?<=_)/).flatMap((part, at) => (at ? [el("wbr"), part] : [part]));
}

// A short wait, so that the pointer may cross the list.
function hover(effect) {
  clearTimeout(hovering);
  hovering = setTimeout(() => told.hovered !== effect && tell({ hovered: effect }), effect ? 70 : 160);
}

function accept(actions, selection) {
  // Of a refit the line of its progress says what it reached.
  const preview = told.preview?.effects.length && !told.preview.refitted ? told.preview : null, ticked = view.ticked.length > 0;
  const busy = told.session?.tasks.some(atWork);
  return el("div", { class: "aside accept" },
    preview ? el("p", { id: "preview-sentence", role: "status" }, minus(preview.sentence)) : told.facts.stage !== "ready" ? null : el("p", { class: "quiet" }, "Point at a cause to preview it without a refit; tick several to preview them together."),
    preview ? el("pre", { tabindex: "0", "aria-label": "command" }, preview.command) : null,
    el("div", { class: "row" },
      el("button", { class: "main", id: "accept", "data-key": "accept", disabled: !ticked || busy, title: "adds the ticked causes; key a", onclick: actions.accept }, "add, and refit"),
      selection || told.facts.verdict === "unexplained_structure" ? el("button", { "data-key": "formula", id: "formula", onclick: () => actions.formula(view.channel) }, `formula of ${view.channel}`) : null,
      told.facts.named.length > 1 ? el("button", { "data-key": "tick-named", id: "tick-named", title: told.facts.named.join(", "), disabled: told.facts.stage !== "ready", onclick: () => show({ ticked: [...new Set([...view.ticked, ...told.facts.named])] }) }, `tick all ${told.facts.named.length} named`) : null,
      el("button", { "data-key": "untick", disabled: !ticked, onclick: () => show({ ticked: [] }) }, "untick")));
}
