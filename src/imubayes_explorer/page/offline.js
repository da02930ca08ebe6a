// Answers of a saved page: what was kept of the models, without a server.

const place = document.getElementById("kept");
export const kept = place ? JSON.parse(place.textContent) : null;

const decodedColumns = new Map();

function numbers(text) {
  if (!decodedColumns.has(text)) decodedColumns.set(text, new Float32Array(Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer));
  return decodedColumns.get(text);
}

function find(id) {
  return kept.models.find((model) => model.facts.id === id);
}

const refusal = "a saved page has no server: start `imubayes explore FOLDER` to continue";

export function savedAnswer(name, body) {
  const model = body && find(body.model);
  if (!model) throw new Error(name === "model" ? "this model was not open when the page was saved" : refusal);
  if (name === "estimates") return model.calibration;
  if (name === "point") return point(model, body.entry);
  if (name === "model" || name === "known") return model[name === "model" ? "facts" : name];
  if (name === "selection") return selection(model, body.brushes);
  if (name === "preview") {
    const found = body.effects.length === 1 && model.previews.find((each) => each.facts.effects[0] === body.effects[0]);
    if (!found) throw new Error(`the saved page previews the most probable causes, one at a time; ${refusal}`);
    return found.facts;
  }
  throw new Error(refusal);
}

function chooser(model, brushes) {
  const { columns, facts } = model, run = numbers(columns.run), channel = numbers(columns.channel), row = numbers(columns.row);
  const tests = brushes.map((brush) => {
    const x = brush.x ? numbers(columns[`x:${brush.x}`]) : null, y = brush.y ? numbers(columns[brush.y]) : null;
    return (k) => (!brush.channels?.length || brush.channels.includes(facts.channels[channel[k]]))
      && (!brush.runs?.length || brush.runs.includes(facts.runs[run[k]]))
      && (!brush.rows?.length || brush.rows.includes(row[k]))
      && (!x || (x[k] >= brush.x_low && x[k] <= brush.x_high)) && (!y || (y[k] >= brush.y_low && y[k] <= brush.y_high));
  });
  return (k) => tests.some((test) => test(k));
}

function selection(model, brushes) {
  const chosen = chooser(model, brushes), known = numbers(model.columns.known), run = numbers(model.columns.run), runs = new Set();
  let n = 0, chi2 = 0;
  for (let k = 0; k < model.count; k++) {
    if (!chosen(k)) continue;
    n += 1;
    chi2 += known[k] ** 2;
    runs.add(model.facts.runs[run[k]]);
  }
  const sentence = `${n} readings: χ² ${chi2.toPrecision(4)}. Their causes need the server.`;
  return { n, of: model.of, chi2, nothing: null, offset: null, causes: [], sentence, runs: [...runs] };
}

function point(model, entry) {
  const { columns, facts } = model, run = facts.runs[numbers(columns.run)[entry]], channel = numbers(columns.channel)[entry];
  const said = (value) => `${+value.toPrecision(6)}`.replaceAll("-", "−");
  const noise = numbers(columns.noise)[entry], places = Math.max(0, Math.min(8, 1 - Math.floor(Math.log10(noise))));
  const known = (value) => value.toFixed(places).replaceAll("-", "−"), observed = numbers(columns.observed)[entry], residual = numbers(columns.known)[entry];
  const settings = facts.abscissae.filter((axis) => axis.name !== "reading" && Number.isFinite(numbers(columns[`x:${axis.name}`])[entry]));
  return { entry, run, row: numbers(columns.row)[entry], channel: facts.channels[channel], values: [
    [facts.channels[channel], `${known(observed)} ± ${known(noise)} ${model.units[channel]}`], ["over known noise", `${+residual.toPrecision(3)}`.replaceAll("-", "−")],
    ...settings.map((axis) => [axis.phrase, `${said(numbers(columns[`x:${axis.name}`])[entry])} ${axis.unit}`.trim()])] };
}

export function savedPoints(wanted) {
  const model = find(wanted.model);
  if (!model) throw new Error(refusal);
  const { columns, facts } = model, column = (name) => numbers(columns[name]);
  const x = column(`x:${wanted.x}`), run = column("run"), channel = column("channel"), own = facts.channels.indexOf(wanted.channel);
  const [low, high] = wanted.between ?? [-Infinity, Infinity], places = [];
  for (let k = 0; k < model.count; k++) {
    if (channel[k] === own && x[k] >= low && x[k] <= high && (!wanted.runs.length || wanted.runs.includes(facts.runs[run[k]]))) places.push(k);
  }
  places.sort((one, other) => x[one] - x[other]);
  const preview = model.previews.find((each) => wanted.effects.length === 1 && each.facts.effects[0] === wanted.effects[0]);
  const chosen = chooser(model, wanted.brushes), labels = facts.labels.find((each) => each.by === wanted.colour).labels, groups = [...new Set(labels)];
  const y = column(wanted.y), known = column("known"), pick = (values) => Float32Array.from(places, (k) => values[k]);
  const after = preview ? numbers(preview.after) : known, axis = facts.abscissae.find((each) => each.name === wanted.x);
  return {
    head: {
      count: places.length, of: places.length, groups, arrays: [], y_factor: 1, x_label: axis.unit ? `${axis.phrase} / ${axis.unit}` : axis.phrase,
      y_label: { known: "residual / known noise", input: "residual / input unit", fitted: "residual / fitted noise" }[wanted.y],
      output_label: `${wanted.channel} / ${model.units[own]}`,
    },
    entry: places, x: pick(x), observed: pick(column("observed")), predicted: pick(column("predicted")), band: pick(column("band")), y: pick(y),
    sd: wanted.y === "input" ? Float32Array.from(places, (k) => 1.96 * column("sd")[k]) : new Float32Array(places.length).fill(1.96),
    group: Float32Array.from(places, (k) => groups.indexOf(labels[run[k]])), marked: Float32Array.from(places, (k) => Number(chosen(k))),
    curve: pick(preview ? numbers(preview.curve) : column("predicted")),
    // What a cause takes off is in proportion on every scale of a reading.
    after: Float32Array.from(places, (k) => (known[k] ? (y[k] * after[k]) / known[k] : y[k])),
  };
}
