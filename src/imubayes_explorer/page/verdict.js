// The verdict sentence and how probable each kind of explanation is.

import { bar, el, fill, odds, probability } from "./dom.js";
import { told } from "./state.js";

const KINDS = {
  nothing: "nothing missing", noise: "other noise", effects: "effects missing", input: "a wrong record",
  outside: "outside the catalogue",
};

export function drawVerdict(place) {
  const facts = told.facts;
  if (!facts) {
    fill(place, el("p", { class: "sentence" }, told.lost ? "" : "Opening the model …"));
    return;
  }
  const kinds = facts.explanations.map((each) => el("span", { class: "kind", title: odds(each.log_odds) },
    KINDS[each.kind], bar(each.probability), el("span", { class: "number" }, probability(each.probability))));
  fill(place,
    el("p", { class: "sentence", id: "sentence", tabindex: "0", title: facts.evidence }, facts.sentence),
    el("div", { class: "kinds" }, kinds, el("span", { class: "quiet" },
      `${facts.campaign}, model ${facts.name}: χ² ${facts.chi2.toFixed(1)} for ${facts.dof.toFixed(0)} outputs at the noise known beforehand`)));
}
