// Keyboard: every gesture has a key; `?` lists them.

import { el, fill } from "./dom.js";

const KEYS = [
  ["?", "this list"], ["t", "guided tour"], ["h", "fold or unfold the verdict"], ["m", "to the map; arrows walk, Enter selects a cell"],
  ["r", "to the residuals; ← → move a selection, ⇧ ← → change its width"], ["c", "to the causes; Space ticks one, Enter adds the ticked ones"],
  ["a", "add the ticked causes, and refit"], ["x", "cancel the running task"], ["u", "undo: back to the previous model"],
  ["n", "next channel (N: the previous one)"], ["v", "next covariate on the abscissa (V: the previous one)"],
  ["y", "next kind of residual"], ["o", "only selected runs"], ["p", "residual after the preview"], ["b", "side by side: the residuals of the previous model, or with the preview, on the same axes"], ["f", "formula of the residual of this channel, as an effect to add"],
  ["w", "draw a shape over the residuals: arrows move, Space sets a point, Enter gets its formula"], ["g", "the panels as SVG (G: PNG)"], ["s", "set the selected readings aside, with a reason"], ["z", "zoom to the selection (Z: whole range)"], ["Esc", "clear the selection, then the ticks"],
  ["1 … 4", "models, estimates, what is known, commands"], ["e", "export the selected model"], ["d", "light or dark"],
];

export function listenToKeys(actions) {
  document.addEventListener("keydown", (event) => {
    if (event.altKey || event.ctrlKey || event.metaKey || document.getElementById("dialog").open) return;
    const target = event.target, typing = ["TEXTAREA", "SELECT"].includes(target.tagName) || (target.tagName === "INPUT" && target.type !== "checkbox");
    if (typing) return;
    if (event.key === "Enter" && target.classList.contains("tick")) {
      event.preventDefault();
      actions.a();
      return;
    }
    const act = actions[event.key];
    if (act) {
      event.preventDefault();
      act();
    }
  });
}

export function helpDialog(dialog) {
  fill(dialog, el("form", { method: "dialog" }, el("h2", { id: "dialog-title" }, "Keys"),
    el("table", {}, el("tbody", {}, KEYS.map(([key, words]) => el("tr", {}, el("td", {}, el("kbd", {}, key)), el("td", {}, words))))),
    el("p", { class: "quiet" }, "With the mouse: drag on a panel to select readings, click one to select it alone, ⇧ adds to the selection; the wheel zooms; point at a reading to see its values, at a cause to preview it; a click in the legend shows its runs alone."),
    el("button", { class: "main", autofocus: true }, "close")));
  dialog.showModal();
}
