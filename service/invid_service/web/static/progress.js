// How far a run is: what is done or weighed now, what is left, and that it still looks.
import { $, fmt, seconds } from "./dom.js";
import { named, phase, t } from "./texts.js";

const QUIET_S = 5;
const seen = { run: null, text: "", since: 0, heard: 0, eta: null, state: "" };

export function showProgress(run) {
  $("bar").value = run.progress;
  const now = Date.now();
  if (seen.run !== run.id || seen.state !== run.state) Object.assign(seen, { run: run.id, state: run.state, text: "", since: now });
  const weighed = run.cause && t(run.axis ? "progress.weighing_on" : "progress.weighing", { cause: named("cause", run.cause), axis: run.axis });
  const parts = weighed ? [weighed] : [phase(run.phase), run.axis && !run.phase.includes(run.axis) && t("progress.axis", { axis: run.axis }), run.frequency && `${fmt(run.frequency, 3)} Hz`];
  Object.assign(seen, { heard: now, eta: run.eta_s, text: t("progress.percent", { n: Math.round(run.progress * 100), what: parts.filter(Boolean).join(", ") }) });
  write();
}

// Between two events the clock goes on, so that nobody takes a long look for a hang.
function write() {
  const now = Date.now(), silent = (now - seen.heard) / 1000, parts = [seen.text];
  const left = seen.eta == null ? null : seen.eta - silent;
  if (left > 0.5) parts.push(t("progress.left", { time: seconds(left) }));
  else if (seen.state === "analysing" && (now - seen.since) / 1000 > QUIET_S) parts.push(t("progress.looking", { time: seconds((now - seen.since) / 1000) }));
  const text = parts.join(", ");
  if ($("phase").textContent !== text) $("phase").textContent = text;
}
setInterval(() => { if (!$("progress").hidden) write(); }, 1000);
