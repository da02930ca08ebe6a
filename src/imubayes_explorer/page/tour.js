// Nine steps that teach the loop to someone who has never seen a score test.

import { el, fill } from "./dom.js";

const STEPS = [
  ["top", "The verdict", "A model was fitted to all runs of the unit together. This sentence says whether it explains them, and the bars say how probable each kind of explanation is: nothing missing, other noise, effects that the model lacks, a wrong record, or a cause outside the catalogue."],
  ["map", "Where the model fails", "Each cell is one channel of one run. The number is χ² per reading at the noise known beforehand: noise alone gives 1. Bright cells show where the model fails."],
  ["charts", "The residual", "Above: measurement and model; they look alike, since the residual is small. Below: measurement minus model. If the residual is pure noise, 95 % of the points lie in the band, without a pattern. Choose the abscissa: a cause shows a pattern against the quantity on which it depends."],
  ["residuals", "Ask about points", "Drag over residuals that look wrong, or click a cell of the map. The list on the right then refers to these readings: it gives the probability of each cause, of noise alone, and of a cause that affects only these readings."],
  ["causes", "Ranked causes", "Without a selection, the list ranks all missing effects by their probability given all data. Effects that these runs cannot distinguish form a group, with the run that would distinguish them."],
  ["causes", "Preview", "Point at a cause. The dashed lines in the panels show the part of the residual that it would explain; the map shows the expected χ². Nothing is fitted again: the model is linearised at the fit. Tick several causes to see them together."],
  ["below", "Its effect on the calibration", "The tab Estimates lists the scale factors, biases and angles that would change, with an arrow, in units of their standard uncertainties. The missing effect biases these estimates now."],
  ["causes", "Add it", "The button adds the ticked causes and fits again. The points move to their predicted residuals at once. After the fit, the predicted and observed drops of χ² are compared, and cross-validation shows whether the addition predicts runs that were left out better."],
  ["below", "Nothing is lost", "Every model tried is in the tree, and has its own folder. Undo returns to the previous model; the selected one is exported. The tab Commands shows your steps as a script."],
];

export function tour(dialog, at = 0) {
  document.querySelector(".toured")?.classList.remove("toured");
  if (at < 0 || at >= STEPS.length) {
    dialog.close();
    return;
  }
  const [place, title, words] = STEPS[at];
  document.getElementById(place)?.classList.add("toured");
  fill(dialog, el("h2", { id: "dialog-title" }, `${at + 1} of ${STEPS.length}: ${title}`), el("p", {}, words),
    el("div", { class: "row spread" }, el("button", { onclick: () => tour(dialog, STEPS.length) }, "end"),
      el("span", { class: "row" }, at ? el("button", { onclick: () => tour(dialog, at - 1) }, "back") : null,
        el("button", { class: "main", onclick: () => tour(dialog, at + 1) }, at + 1 < STEPS.length ? "next" : "done"))));
  dialog.onclose = () => document.querySelector(".toured")?.classList.remove("toured");
  if (!dialog.open) dialog.showModal();
  dialog.querySelector("button.main").focus();
}
