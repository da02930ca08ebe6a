// Nine steps that teach the loop to someone who has never seen a score test, each beside its panel.

import { el, fill } from "./dom.js";
import { onChange, told } from "./state.js";

// Panel, title, words, and what of the user's own a step waits for.
const STEPS = [
  ["top", "The verdict", "A model was fitted to all runs of the unit together. This sentence says whether it explains them, and the bars say how probable each kind of explanation is: nothing missing, other noise, effects that the model lacks, a wrong record, or a cause outside the catalogue."],
  ["map", "Where the model fails", "Each cell is one channel of one run. The number is χ² per reading at the noise known beforehand: noise alone gives 1. The cells that stand out show where the model fails."],
  ["charts", "The residual", "Above: measurement and model; they look alike, since the residual is small. Below: measurement minus model. If the residual is pure noise, 95 % of the points lie in the band, without a pattern. Choose the abscissa: a cause shows a pattern against the quantity on which it depends."],
  ["residuals", "Ask about points", "Drag over residuals that look wrong, or click a cell of the map. The list of causes then refers to these readings: it gives the probability of each cause, of noise alone, and of a cause that affects only these readings. The tour continues when you have selected some.", "selection"],
  ["causes", "Ranked causes", "Your selection is ranked here; Esc clears it. Without a selection, the list ranks all missing effects by their probability given all data. Effects that these runs cannot distinguish form a group, with the run that would distinguish them."],
  ["causes", "Preview", "Point at a cause. The dashed lines in the panels show the part of the residual that it would explain; the map shows the expected χ². Nothing is fitted again: the model is linearised at the fit. Tick several causes to see them together. The tour continues when you have ticked one, or pointed at one.", "preview"],
  ["below", "Its effect on the calibration", "The tab Estimates lists the scale factors, biases and angles that would change, with an arrow, in units of their standard uncertainties. The missing effect biases these estimates now."],
  ["causes", "Add it", "The button adds the ticked causes and fits again. The points move to their predicted residuals at once. After the fit, the predicted and observed drops of χ² are compared, and cross-validation shows whether the addition predicts runs that were left out better."],
  ["below", "Nothing is lost", "Every model tried is in the tree, and has its own folder. Undo returns to the previous model; the selected one is exported. The tab Commands shows your steps as a script."],
];

const GAP = 10, box = el("div", { id: "tour", role: "dialog", "aria-labelledby": "tour-title" });
let now = -1;

box.addEventListener("keydown", (event) => {
  if (event.key !== "Escape") return;
  event.stopPropagation();
  go(-1);
});
window.addEventListener("resize", () => now >= 0 && place());

// What a step waits for was done on the page, where the focus stays.
onChange((_, heard) => {
  const wanted = STEPS[now]?.[3];
  if (wanted === "selection" && heard.includes("selection") && told.selection?.n) go(now + 1, false);
  if (wanted === "preview" && heard.includes("preview") && told.preview?.effects.length) go(now + 1, false);
});

export function tour() {
  go(0);
}

function go(step, focused = true) {
  document.querySelector(".toured")?.classList.remove("toured");
  now = step < STEPS.length ? step : -1;
  if (now < 0) {
    box.remove();
    return;
  }
  const [panel, title, words, wanted] = STEPS[now];
  document.getElementById(panel)?.classList.add("toured");
  const last = now + 1 === STEPS.length;
  fill(box, el("h2", { id: "tour-title" }, `${now + 1} of ${STEPS.length}: ${title}`), el("p", {}, words),
    el("div", { class: "row spread" }, el("button", { onclick: () => go(-1) }, "end"),
      el("span", { class: "row" }, now ? el("button", { onclick: () => go(now - 1) }, "back") : null,
        el("button", { class: wanted ? "" : "main", id: "tour-next", onclick: () => go(now + 1) }, last ? "done" : wanted ? "skip" : "next"))));
  if (!box.isConnected) document.body.append(box);
  place();
  if (focused) box.querySelector("#tour-next").focus({ preventScroll: true });
}

// Right of its panel, left, below or above it, where there is room; at the foot of a narrow window.
function place() {
  const panel = document.getElementById(STEPS[now][0]);
  panel?.scrollIntoView({ block: "nearest" });
  const { left, right, top, bottom } = panel.getBoundingClientRect(), { offsetWidth: width, offsetHeight: height } = box;
  const across = Math.max(GAP, Math.min(innerWidth - width - GAP, left)), down = Math.max(GAP, Math.min(innerHeight - height - GAP, top));
  const places = [[right + GAP, down], [left - width - GAP, down], [across, bottom + GAP], [across, top - height - GAP]];
  const fits = ([x, y]) => x >= 0 && y >= 0 && x + width <= innerWidth && y + height <= innerHeight;
  const [x, y] = places.find(fits) ?? [Math.max(0, (innerWidth - width) / 2), innerHeight - height - GAP];
  Object.assign(box.style, { left: `${x}px`, top: `${y}px` });
}
