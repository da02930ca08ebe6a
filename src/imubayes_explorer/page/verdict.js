// The verdict and how probable each kind of explanation is; folded, map and residuals are seen without being told.

import { bar, el, fill, minus, odds, probability } from "./dom.js";
import { tell, told } from "./state.js";

const KINDS = {
  nothing: "nothing missing", noise: "other noise", effects: "effects missing", input: "a wrong record",
  outside: "outside the catalogue",
};

export function fold() {
  tell({ folded: !told.folded });
  try {
    localStorage.setItem("imubayes-folded", told.folded ? "yes" : "");
  } catch { /* private windows forget it */ }
}

export function drawVerdict(place) {
  const facts = told.facts;
  if (!facts) {
    fill(place, el("p", { class: "sentence" }, told.lost ? "" : "Opening the model …"));
    return;
  }
  const kinds = facts.explanations.map((each) => el("span", { class: "kind", title: odds(each.log_odds) },
    KINDS[each.kind], bar(each.probability), el("span", { class: "number" }, probability(each.probability))));
  fill(place,
    el("div", { class: "kinds" },
      el("button", { class: "plain quiet", id: "fold", "data-key": "fold", "aria-expanded": String(!told.folded), title: "key h: fold or unfold the verdict", onclick: fold }, told.folded ? "▸ verdict" : "▾ verdict"),
      told.folded ? null : kinds,
      el("span", { class: "quiet" }, `${facts.campaign}, model ${facts.name}: χ² ${facts.chi2.toFixed(1)} for ${facts.dof.toFixed(0)} outputs at the noise known beforehand`)),
    told.folded ? null : el("p", { class: "sentence", id: "sentence", title: minus(facts.evidence) }, minus(facts.sentence) || "The explanations are being weighed; map and residuals are those of the fit."));
}
