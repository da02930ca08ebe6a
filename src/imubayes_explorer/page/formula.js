// What the catalogue lacks: a formula for the residual of a channel, the effect that it becomes, and its addition.

import { el, fill } from "./dom.js";

export function formulaDialog(dialog, channel, found, add) {
  const table = found.table ? el("table", {}, el("thead", {}, el("tr", {}, found.table.head.map((words) => el("th", { class: "left" }, words)))),
    el("tbody", {}, found.table.rows.map((row) => el("tr", {}, row.map((text) => el("td", {}, text)))))) : null;
  fill(dialog, el("form", { method: "dialog" },
    el("h2", { id: "dialog-title" }, `Formula of the residual of ${channel}`),
    el("p", {}, found.sentence), table, found.table?.note ? el("p", { class: "quiet" }, found.table.note) : null,
    found.source ? el("p", { class: "quiet" }, "The formula as an effect. Adding it writes this file beside the results, fits again, and shows by cross-validation whether it predicts runs that were left out better.") : null,
    found.source ? el("pre", { tabindex: "0" }, found.source) : null,
    el("div", { class: "row" },
      found.source ? el("button", { class: "main", id: "add-formula", onclick: add }, `add it on ${channel}, and refit`) : null,
      el("button", {}, "close"))));
  dialog.showModal();
}
