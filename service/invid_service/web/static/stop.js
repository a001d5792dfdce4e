// STOP of one cell or of all: asked again, with no key and whatever else fails, until the service says that
// nothing moves, or that nobody knows. It is no safety function.
import { post } from "./api.js";
import { $, clock } from "./dom.js";
import { whyNot } from "./spoken.js";
import { find, look, onState } from "./store.js";
import { and, t } from "./texts.js";

const PATIENCE_MS = 2000, AGAIN_MS = 500, LONG_MS = 8000, SHOWN_MS = 120000;
const ALL = "", asked = new Map();
const name = (cell) => (cell === ALL ? t("stop.all_cells") : find(cell)?.name ?? cell);

export async function stop(cell = ALL) {
  if (asked.has(cell) && !asked.get(cell).ended) return; // it is being asked
  const one = { cell, began: Date.now(), ended: 0, failure: null, met: new Map(), lost: new Set() };
  asked.delete(cell); // the newest is written last
  asked.set(cell, one);
  for (;;) {
    write();
    try {
      const answer = await post(cell === ALL ? "/stop" : `/cells/${cell}/stop`, undefined, {}, PATIENCE_MS), cells = answer.cells ?? [answer];
      const going = cells.filter((c) => c.stopping);
      one.lost = new Set(cells.filter((c) => c.unknown).map((c) => c.cell));
      one.failure = null;
      for (const c of going) one.met.set(c.cell, c.moved || one.met.get(c.cell));
      if (!going.length) one.ended = Date.now();
    } catch (error) { one.failure = whyNot(error); }
    write();
    look();
    if (one.ended) return;
    await new Promise((wake) => setTimeout(wake, AGAIN_MS));
  }
}

function said({ cell, began, ended, failure, met, lost }) {
  const values = { cell: name(cell), time: clock(ended || began), why: failure };
  if (failure) return t("stop.failed", values);
  if (!ended) return t(Date.now() - began > LONG_MS ? "stop.slow" : "stop.stopping", values);
  const names = (moved) => [...met].filter(([c, m]) => m === moved && !lost.has(c)).map(([c]) => name(c)), parts = [];
  if (lost.size) parts.push(t("stop.unknown", { ...values, cell: and([...lost].map(name)) }));
  if (names(true).length) parts.push(t("stop.stopped", { ...values, cell: and(names(true)) }));
  if (names(false).length) parts.push(t("stop.ended", { ...values, cell: and(names(false)) }));
  return parts.join(" ") || t("stop.nothing", values);
}

function write() {
  for (const [cell, one] of asked) if (one.ended && Date.now() - one.ended > SHOWN_MS) asked.delete(cell);
  const all = [...asked.values()], text = all.map(said).join(" ") || t("stop.note");
  if ($("stop-note").textContent !== text) $("stop-note").textContent = text;
  $("stop-note").className = all.some((one) => one.failure || (one.ended && one.lost.size) || (!one.ended && Date.now() - one.began > LONG_MS)) ? "failed" : "";
}
onState(write);
