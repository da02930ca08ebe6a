// The tabs at the bottom: tree of models, estimates with what a preview moves, and the commands of every click.

import { compact, digits, el, fill, minus } from "./dom.js";
import { drawEstimates } from "./estimates.js";
import { drawKnowledge } from "./knowledge.js";
import { show, told, view } from "./state.js";

const TABS = { models: "Models", estimates: "Estimates", knowledge: "What is known", commands: "Commands" };
const panel = el("div", { role: "tabpanel", id: "tab-panel" }), head = el("div", { class: "head" });

// How a tab is drawn, and what it shows of the view and of what is told: nothing else draws it anew, under what is typed or folded there.
const DRAWN = {
  models: [models, "facts", "kept"], estimates: [drawEstimates, "facts", "preview"], knowledge: [drawKnowledge, "facts", "quantities"], commands: [commands, "facts", "kept"],
};

export function drawTab(actions, seen, heard) {
  const [draw, ...shown] = Object.hasOwn(DRAWN, view.tab) ? DRAWN[view.tab] : DRAWN.models;
  if (shown.some((name) => heard.includes(name) || seen.includes(name)) || seen.includes("tab") || seen.includes("model")) draw(panel, actions);
}

export function drawBelow(place, actions) {
  const tabs = Object.entries(TABS).map(([name, words], at) => el("button", {
    role: "tab", id: `tab-${name}`, "data-key": `tab-${name}`, "aria-selected": String(view.tab === name), "aria-controls": "tab-panel",
    title: `key ${at + 1}`, onclick: () => show({ tab: name }),
  }, words));
  fill(head, el("div", { class: "tabs", role: "tablist" }, tabs), side(actions));
  panel.setAttribute("aria-labelledby", `tab-${view.tab}`);
  if (!panel.isConnected) fill(place, head, panel);
}


function side(actions) {
  if (view.tab === "commands") {
    return el("div", { class: "row" }, el("button", { "data-key": "copy", onclick: actions.copy }, "copy as a script"), el("button", { "data-key": "script", onclick: actions.script }, "save it"));
  }
  return el("div", { class: "row" },
    el("button", { "data-key": "undo", id: "undo", onclick: actions.undo, disabled: !parentOf(view.model), title: "key u: back to the previous model" }, "undo"),
    el("button", { "data-key": "export", id: "export", onclick: actions.export }, "export the selected model"),
    el("button", { "data-key": "save", id: "save", onclick: actions.save }, "save as a page"));
}

export function parentOf(model) {
  return told.session?.tree.find((line) => line.id === model)?.parent ?? "";
}

function models(panel, actions) {
  const tree = told.session?.tree ?? [];
  const units = [...new Set(tree.flatMap((line) => Object.keys(line.rms)))];
  const head = ["χ²/n", "Δχ² predicted", "observed", "Δ elpd", ...units.map((unit) => `rms / ${unit === "deg/s" ? "deg/h" : unit === "g" ? "µg" : unit}`), "exported", "note"];
  const rows = tree.map((line) => el("tr", { class: line.id === view.model ? "chosen" : "" },
    el("td", { class: "left" }, "\u2003".repeat(line.depth), line.depth ? "└ " : "",
      el("button", { class: "plain", "data-key": `model-${line.id}`, "aria-current": line.id === view.model ? "true" : null, disabled: !line.taken, title: line.note || line.folder, onclick: () => show({ model: line.id, ticked: [] }) }, line.name || line.title),
      line.taken ? "" : " ✕ not taken"),
    el("td", { "data-label": head[0] }, line.chi2 && line.dof ? (line.chi2 < 99 * line.dof ? (line.chi2 / line.dof).toFixed(2) : compact(line.chi2 / line.dof)) : "–"),
    el("td", { "data-label": head[1] }, digits(line.delta_chi2.predicted)), el("td", { "data-label": `Δχ² ${head[2]}` }, digits(line.delta_chi2.observed)),
    el("td", { "data-label": head[3] }, minus(line.gain)),
    units.map((unit, at) => el("td", { "data-label": head[4 + at] }, size(line.rms[unit], unit))),
    el("td", { "data-label": "exported" }, line.selected ? "● selected" : line.taken ? el("button", { class: "plain", "data-key": `select-${line.id}`, onclick: () => actions.select(line.id) }, "○ select") : ""),
    el("td", { "data-label": "note" }, el("button", { class: "plain", "data-key": `note-${line.id}`, title: line.note || "name and note", onclick: () => actions.note(line) }, line.note ? "✎ note" : "✎"))));
  const effects = (told.facts?.effects ?? []).map(({ name, channels }) => el("span", { class: "chip" }, name, channels.length ? el("span", { class: "quiet" }, ` ${channels.join(", ")}`) : null,
    el("button", { class: "plain", "data-key": `remove-${name}-${channels.join("-")}`, title: `remove ${name}, and refit`, "aria-label": `remove ${name}${channels.length ? ` of ${channels.join(", ")}` : ""}`, onclick: () => actions.change({ remove: [name] }) }, "×")));
  const aside = (told.facts?.set_aside ?? []).map((words, at) => el("span", { class: "chip" }, words,
    el("button", { class: "plain", "data-key": `back-${at}`, title: "take these readings back, and refit", "aria-label": `take back ${words}`, onclick: () => actions.change({ take_back: [at] }) }, "↩")));
  fill(panel,
    el("table", { class: "wide" }, el("thead", {}, el("tr", {}, el("th", { class: "left" }, "model"), head.map((words) => el("th", {}, words)))), el("tbody", {}, rows)),
    el("h3", { class: "quiet aside" }, "Effects of the model that is shown"), el("div", { class: "chips" }, effects),
    aside.length ? el("h3", { class: "quiet aside" }, "Readings set aside") : null, aside.length ? el("div", { class: "chips" }, aside) : null);
}

function size(value, unit) {
  if (value === undefined) return "–";
  return digits(value * ({ "deg/s": 3600, g: 1e6 }[unit] ?? 1));
}

function commands(panel) {
  const own = told.session?.commands ?? [];
  fill(panel, el("p", { class: "quiet" }, "Your steps as commands: page and command line use the same functions and folders."),
    el("pre", { id: "commands", tabindex: "0" }, own.join("\n")),
    told.facts?.command ? el("p", { class: "aside" }, "Next, by the diagnosis: ", el("code", {}, told.facts.command)) : null);
}

export function asideDialog(dialog, count, keep) {
  const reason = el("input", { id: "reason", size: "50", maxlength: "400", required: true });
  fill(dialog, el("form", { method: "dialog", onsubmit: () => keep(reason.value) },
    el("h2", { id: "dialog-title" }, `Set ${count} readings aside`),
    el("p", { class: "quiet" }, "A branch of the tree is fitted without them. Their files are not changed, the model states the reason, and they can be taken back."),
    el("p", {}, el("label", { for: "reason" }, "reason "), reason),
    el("div", { class: "row" }, el("button", { class: "main", id: "set-aside" }, "set aside, and refit"), el("button", { type: "button", onclick: () => dialog.close() }, "cancel"))));
  dialog.showModal();
  reason.focus();
}

export function noteDialog(dialog, line, keep) {
  const name = el("input", { value: line.name, maxlength: "120", id: "note-name" }), note = el("textarea", { rows: "5", cols: "56", maxlength: "4000", id: "note-text" }, line.note);
  fill(dialog, el("form", { method: "dialog", onsubmit: () => keep(name.value, note.value) },
    el("h2", { id: "dialog-title" }, `Name and note of ${line.title}`),
    el("p", {}, el("label", { for: "note-name" }, "name "), name), el("p", {}, el("label", { for: "note-text" }, "note "), note),
    el("div", { class: "row" }, el("button", { class: "main" }, "keep"), el("button", { type: "button", onclick: () => dialog.close() }, "cancel"))));
  dialog.showModal();
  name.focus();
}

