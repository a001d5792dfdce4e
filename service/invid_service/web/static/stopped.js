// A run that stopped: where and why, the one thing to do and where, the last seconds.
import { traceChart } from "./charts.js";
import { $, el, fill, sentence, MOTION } from "./dom.js";
import { phase, said } from "./said.js";
import { has, t } from "./texts.js";

const HERE = { gentler: "stopped.gentler", as_planned: "stopped.as_planned", start_again: "stopped.start_again" };

/** @param {Run} run
 * @param {Cell | null} cell */
export function showStopped(run, cell, again) {
  const s = run.stopped;
  $("stopped").hidden = !s;
  if (!s) return;
  $("stopped-where").textContent = t("stopped.where", { phase: phase(s.phase), axis: s.axis ? t("stopped.axis", { axis: s.axis }) : "" });
  const { code, text, where } = s.action, action = said(text);
  $("stopped-action").textContent = action.text;
  $("stopped-action").lang = action.lang;
  const label = HERE[code], do_ = $("stopped-do");
  $("stopped-place").textContent = t("stopped.place", { where: has(`where.${where}`) ? t(`where.${where}`) : t("where.config", { field: where }) });
  $("stopped-place").hidden = Boolean(label);
  do_.hidden = !label;
  if (label) {
    do_.textContent = t(label);
    do_.onclick = () => again({ amplitude: code === "gentler" ? "gentler" : code === "as_planned" ? "planned" : run.amplitude });
  }
  trace(s, cell);
}

/** @param {Api["StoppedView"]} s
 * @param {Cell | null} cell */
function trace(s, cell) {
  const axis = s.axis ?? busiest(s.trace), times = s.trace?.time_s ?? [], pictures = [];
  const limits = (cell?.limits ?? []).find((l) => l.axis === axis);
  for (const [what, name, unit] of [["position", "position_unit", "rad"], ["torque", "torque_unit", "N·m"]]) {
    const values = s.trace?.[what]?.[axis];
    if (!values?.length || values.length !== times.length) continue;
    // In the units of the plan above, which a person has before the eyes.
    const [shown, factor] = MOTION[limits?.[name] ?? unit] ?? [limits?.[name] ?? unit, 1], limit = limits?.[what];
    const chart = traceChart(sentence(t(`trace.${what}`)), axis, times, values.map((v) => v * factor), shown, limit == null ? null : limit * factor);
    pictures.push(el("figcaption", {}, `${axis}: ${t(`trace.${what}`)} [${shown}]`), chart.picture);
  }
  $("trace").hidden = !pictures.length;
  fill($("trace"), pictures);
}
// Without a named axis the one that moved most.
function busiest(trace) {
  const span = (values) => Math.max(...values) - Math.min(...values);
  return Object.entries(trace?.position ?? {}).filter(([, v]) => v.length).sort((a, b) => span(b[1]) - span(a[1]))[0]?.[0];
}
