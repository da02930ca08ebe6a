// Two models side by side: the residuals of the previous model, or with the preview, on the axes of those that are shown.

import { parentOf } from "./below.js";
import { Chart } from "./chart.js";
import { el } from "./dom.js";
import { drawBand, drawPoints } from "./marks.js";
import { ask, latest, points } from "./net.js";
import { told, view } from "./state.js";

// Ask for the residuals of the previous model this one, which is opened where it is not; whether there is news.
export async function loadBefore(wanted, attempt) {
  const parent = parentOf(view.model);
  if (!view.beside || !parent) {
    told.before = null;
    return false;
  }
  const title = told.session.tree.find((line) => line.id === parent).title;
  const there = await attempt(() => latest("before", (signal) => ask("model", { model: parent }, signal)));
  if (there === undefined) return false;
  const found = there && await attempt(() => latest("before", (signal) => points({ ...wanted, model: parent, effects: [], task: 0 }, signal)));
  if (found === undefined || wanted.model !== view.model) return false;
  told.before = found ? { of: view.model, parent, title, points: found } : { waiting: parent };
  return true;
}

export class Beside {
  constructor(shared) {
    this.title = el("div", { class: "title", id: "beside-title" });
    this.place = el("div", { class: "chart", id: "beside", role: "img", hidden: true }, this.title);
    this.shown = null;
    this.chart = new Chart(this.place, {
      ...shared(this.place), both: false, draw: (context, at) => this.draw(context, at),
      onPoint: () => {}, onPick: () => {}, places: () => null,
    });
  }

  build() {
    this.chart.build();
  }

  // Those of the same model with a preview or before its refit, else those of the previous model; null for none.
  points(previewing) {
    if (!view.beside || !told.points) return null;
    if (previewing) return { points: told.points, y: told.points.after, title: `with ${told.preview.effects.join(", ")}`, later: true };
    if (told.points.head.refitted) return { points: told.points, y: told.points.held, title: "before the refit", later: false };
    const { before } = told;
    if (before?.of !== view.model) return null;
    // What is selected is selected in both: a brush of residuals is meant of those that are shown.
    const marked = before.points.head.count === told.points.head.count ? told.points.marked : before.points.marked;
    return { points: { ...before.points, marked }, y: before.points.y, title: "of the previous model", model: before.title, later: false };
  }

  show(other, ranges, head) {
    this.shown = other;
    this.place.hidden = !view.beside;
    this.place.parentElement.className = view.beside ? `pair two ${other?.later ? "later" : ""}` : "pair";
    if (!view.beside) return;
    this.title.textContent = other ? `residual ${other.title}` : told.before?.waiting ? "The previous model is being opened." : "There is no previous model: preview a cause to see its residuals here.";
    this.title.title = other?.model ?? "";
    this.place.setAttribute("aria-label", other ? `Residuals of ${view.channel} ${other.title}${other.model ? `, ${other.model}` : ""}: ${other.points.head.of} readings, on the same axes.` : this.title.textContent);
    this.chart.show(ranges, head.x_label, head.y_label);
  }

  draw(context, at) {
    if (!this.shown) return;
    drawBand(context, at, this.shown.points);
    drawPoints(context, at, this.shown.points, this.shown.y, false);
  }
}
