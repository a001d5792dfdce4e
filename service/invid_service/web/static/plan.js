// What will move and how far, before anybody arms.
import { $, el, fill, fmt, moved, seconds, table } from "./dom.js";
import { spoken, supporting } from "./spoken.js";
import { t } from "./texts.js";

/** @param {Run} run
 * @param {Cell | null} cell */
export function showPlan(run, cell) {
  const plan = run.plan;
  // What cannot be foretold is bounded all the same: the sweep stops every axis at its limits.
  const limits = new Map((cell?.limits ?? []).map((l) => [l.axis, l]));
  table($("plan-table"), [t("plan.axis"), t("plan.torque"), t("plan.travel"), t("plan.speed")], (plan.forecast ?? []).map((f) => {
    const l = limits.get(f.axis), shown = (v) => moved(v, f.unit === "N" ? "m" : "rad", 2);
    const most = (v, limit, sign, per) => (v != null && !(v > limit) ? `${sign}${shown(v)}${per}`
      : limit == null ? t("plan.unforeseen") : `${v == null ? `${t("plan.unforeseen")}; ` : ""}${t("plan.stopped_at", { value: `${sign}${shown(limit)}${per}` })}`);
    const travel = most(f.travel, l?.position, "±", ""), speed = most(f.velocity, l?.velocity, "", "/s");
    return { cells: [el("b", {}, f.axis), `±${fmt(f.peak_torque, 3)} ${f.unit}`, travel, speed] };
  }));
  $("plan-facts").textContent = `${t("plan.facts", { time: seconds(plan.duration_s), n: plan.experiments?.length ?? "?" })}${run.simulated ? "" : ` ${t("plan.people")}`}`;
  const notes = plan.warnings ?? [];
  fill($("plan-warnings"), notes.map((w) => spoken("li", w)));
  $("plan-notes").hidden = !notes.length; // unfolded: what is said before arming is read before arming
  $("plan-notes-title").textContent = t("plan.notes", { n: notes.length });
  $("support").hidden = !plan.support || run.state !== "awaiting_arm";
  $("support-text").textContent = supporting(plan.support);
  const beside = [run.separates && t("plan.separates"), run.amplitude === "gentler" && t("plan.gentler")].filter(Boolean);
  $("run-note").hidden = !beside.length || run.state !== "awaiting_arm";
  $("run-note").textContent = beside.join(" ");
}
