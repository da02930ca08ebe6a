// A corner of chosen quantities: prior and posterior on the diagonal, joint regions of pairs below it.

import { digits, minus, shortened } from "./dom.js";

const SVG = "http://www.w3.org/2000/svg", CELL = 118, HEAD = 44, GAP = 6, LEFT = 30, FOOT = 16;
// The range of a quantity is five standard deviations to each side.
const TICKS = [[0.2, "−3 sd"], [0.5, "0"], [0.8, "3 sd"]];

function made(name, attributes = {}, words = "") {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) element.setAttribute(key, value);
  element.textContent = words;
  return element;
}

export function corner({ quantities, pairs, rows }) {
  const count = quantities.length, room = count > 1 ? LEFT : 0, width = room + count * (CELL + GAP), height = count * (CELL + GAP) + FOOT;
  const said = pairs.map(({ across, up, correlation }) => `${quantities[up].name} with ${quantities[across].name} ${shared(correlation)}`);
  const picture = made("svg", {
    viewBox: `0 0 ${width} ${height}`, class: "corner", role: "img", id: "corner",
    "aria-label": `Prior and posterior of ${quantities.map(({ name, from_data }) => `${name}, ${from_data} from data`).join("; ")}.${said.length ? ` Correlations: ${said.join("; ")}.` : ""}`,
  });
  picture.style.maxWidth = `${count > 1 ? 1.3 * width : 300}px`;
  const at = (column, row) => made("g", { transform: `translate(${room + column * (CELL + GAP)} ${row * (CELL + GAP)})` });
  quantities.forEach((quantity, place) => {
    const cell = at(place, place);
    cell.append(...heading(quantity), ...densities(quantity));
    if (count === 1) cell.append(...[0.1, 0.5, 0.9].map((share) => tick(share * CELL, CELL + 11, digits(quantity.x[0] + share * (quantity.x.at(-1) - quantity.x[0]), 6))));
    picture.append(cell);
  });
  for (const pair of pairs) {
    const cell = at(pair.across, pair.up);
    cell.append(made("rect", { width: CELL, height: CELL, class: "frame" }), made("path", { d: `M${CELL / 2} 0V${CELL}M0 ${CELL / 2}H${CELL}`, class: "middle" }));
    pair.regions.forEach(({ share, spans }) => cell.append(made("path", { d: spans.map((span) => slice(span, rows)).join(""), class: share > 0.9 ? "wide" : "narrow" })));
    cell.append(made("text", { x: CELL - 4, y: 11, class: "end" }, `ρ ${shared(pair.correlation)}`));
    picture.append(cell);
  }
  if (count > 1) {
    for (const [share, words] of TICKS) {
      quantities.forEach((_, place) => {
        picture.append(tick(room + place * (CELL + GAP) + share * CELL, count * (CELL + GAP) + 7, words));
        if (place) picture.append(made("text", { x: room - 3, y: place * (CELL + GAP) + (1 - share) * CELL + 3, class: "end" }, words));
      });
    }
  }
  return picture;
}

// Two decimals; close to one as many as show how close.
function shared(correlation) {
  return minus(correlation.toFixed(Math.abs(correlation) > 0.99 ? 4 : 2)).replace("−0.00", "0.00");
}

function tick(x, y, words) {
  return made("text", { x, y, "text-anchor": "middle" }, words);
}

// A name in two lines, as far as a cell is wide; the whole of it, with its numbers, when it is pointed at.
function heading({ name, parts, estimate, sd, unit, from_data, weak }) {
  const lines = [...parts.map((part) => shortened(part, 19)), `${from_data.split(",")[0] || "–"} from data`];
  const words = lines.filter(Boolean).map((line, place) => made("text", { x: 0, y: 10 + 11 * place, class: line === lines[2] ? (weak ? "weak" : "share") : "name" }, line));
  words[0].append(made("title", {}, `${name} ${estimate} ± ${sd} ${unit}`));
  return words;
}

function densities(found) {
  const low = found.x[0], width = found.x.at(-1) - low, tall = CELL - HEAD;
  return [["prior", found.prior], ["posterior", found.posterior]].map(([name, values]) => made("path", {
    class: name, d: found.x.map((x, k) => `${k ? "L" : "M"}${((CELL * (x - low)) / width).toFixed(1)} ${(CELL - 0.97 * tall * values[k]).toFixed(1)}`).join(""),
  }));
}

// One row of a region; rows overlap a little, so that no seam is seen between them.
function slice([row, from, to], rows) {
  const high = CELL / rows, x = CELL * from;
  return `M${x.toFixed(1)} ${(CELL - (row + 1) * high - 0.2).toFixed(2)}h${(CELL * (to - from)).toFixed(1)}v${(high + 0.4).toFixed(2)}h${(-CELL * (to - from)).toFixed(1)}z`;
}
