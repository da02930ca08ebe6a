// What is asked of the server, and what it tells by itself. Paths are relative: the token in the address is the key.

import { kept, savedAnswer, savedPoints } from "./offline.js";

export class Refused extends Error {
  constructor(issues) {
    super(issues.join("\n"));
    this.issues = issues;
  }
}

function keptAnswer(make) {
  try {
    return make();
  } catch (error) {
    throw new Refused([error.message]);
  }
}

async function send(name, body, signal) {
  let answer;
  try {
    answer = await fetch(name, {
      method: body === undefined ? "GET" : "POST", signal,
      headers: body === undefined ? {} : { "Content-Type": "application/json" },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch (error) {
    if (error.name === "AbortError") throw error;
    throw new Refused(["the server does not answer: start `imubayes explore` again, and open the address it prints"]);
  }
  if (answer.ok) return answer;
  const told = answer.headers.get("content-type")?.includes("json") ? (await answer.json()).issues : [await answer.text()];
  throw new Refused(told);
}

export async function ask(name, body, signal) {
  if (kept) return keptAnswer(() => savedAnswer(name, body));
  const answer = await send(name, body, signal);
  return answer.status === 202 && !answer.headers.get("content-type") ? null : answer.json();
}

export async function text(name) {
  if (kept && name === "script.sh") return ["#!/bin/sh", "set -eu", ...kept.state.commands, ""].join("\n");
  if (kept) return keptAnswer(() => savedAnswer(name));
  return (await send(name)).text();
}

// Points: length of the header, the header, then columns of Float32.
export function decoded(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const head = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const found = { head };
  head.arrays.forEach((name, place) => {
    found[name] = new Float32Array(buffer, 4 + length + 4 * place * head.count, head.count);
  });
  return found;
}

export async function points(body, signal) {
  if (kept) return keptAnswer(() => savedPoints(body));
  return decoded(await (await send("points", body, signal)).arrayBuffer());
}

// Only the latest request of a kind is of interest: an earlier one that is still under way is given up.
const underway = new Map();

export async function latest(kind, ask) {
  underway.get(kind)?.abort();
  const own = new AbortController();
  underway.set(kind, own);
  try {
    return await ask(own.signal);
  } catch (error) {
    if (error.name === "AbortError") return undefined;
    throw error;
  } finally {
    if (underway.get(kind) === own) underway.delete(kind);
  }
}

export function listen(onState, onLost, onBack) {
  if (kept) {
    onState({ ...kept.state, tasks: [], opened: kept.state.opened.map((each) => ({ ...each, replaced: false })) });
    return;
  }
  const source = new EventSource("events");
  source.onmessage = (event) => onState(JSON.parse(event.data));
  source.onerror = () => onLost();
  source.onopen = () => onBack();
}
