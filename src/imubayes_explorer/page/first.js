// What is shown before anyone has chosen: the model, the abscissa and the colours.

import { kept } from "./offline.js";

export function firstAbscissa(facts) {
  const said = facts.abscissae.find((axis) => facts.sentence.includes(`depends on ${axis.phrase}`));
  return (said ?? facts.abscissae.find((axis) => axis.name === "table_rate_deg_s") ?? facts.abscissae[0]).name;
}

// Many runs are told apart by their mounting.
export function firstColour(facts) {
  return facts.runs.length > 8 && facts.labels.some(({ by }) => by === "mounting") ? "mounting" : "run";
}

// The selected model; of a saved page one that it holds.
export function firstModel(session) {
  const held = session.tree.filter((line) => session.opened.some((each) => each.id === line.id)), among = kept && held.length ? held : session.tree;
  return among.find((line) => line.selected) ?? among[0];
}
