// Nine steps that teach the loop to someone who has never seen a score test.

import { el, fill } from "./dom.js";

const STEPS = [
  ["top", "The verdict", "A model was fitted to all runs of the unit together. This sentence says whether it explains them, and the bars say how probable each kind of explanation is: nothing missing, other noise, effects that the model lacks, a wrong record, or a cause that nobody has listed."],
  ["map", "Where the model fails", "Each cell is one channel of one run. The number is χ² per reading at the noise that was known before the fit: 1 is what noise alone makes. Bright cells are where something is left over."],
  ["charts", "What is left over", "Above: measurement and model; they look alike, since what is missing is small. Below: measurement less model. Of pure noise 95 % of the points lie in the band, without a pattern. Choose what stands on the abscissa: a cause shows against what it depends on."],
  ["residuals", "Ask about points", "Drag over residuals that look wrong, or click a cell of the map. The list at the right then answers for these readings: how probable is each cause of them, or that they are noise, or a cause of their own."],
  ["causes", "Ranked causes", "Without a selection the list ranks all that could be missing, by its probability given all the data. Effects that these runs cannot tell apart stand together, with the run that would."],
  ["causes", "Preview", "Point at a cause. The dashes in the panels are what it would explain; the map shows the χ² to be expected. No refit is made: the model is linear nearby. Tick several to see them together."],
  ["below", "What it would do to the calibration", "The tab Estimates lists the scale factors, biases and angles that would move, with an arrow, in their standard uncertainties: what the missing effect biases now."],
  ["causes", "Add it", "The button adds what is ticked and fits again. The points move to their new residuals at once, predicted and observed drop of χ² are compared; when the fit is done, runs that were left out tell whether the addition predicts better."],
  ["below", "Nothing is lost", "Every model tried stands in the tree, in a folder of its own. Undo goes back to the one before; the selected one is exported. The tab Commands has what was clicked as a script."],
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
