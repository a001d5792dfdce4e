// A cell's past: accepted models, measurements, every number and cause over time.
import { get, post } from "./api.js";
import { ask } from "./ask.js";
import { historyChart } from "./charts.js";
import { changeLines, headline, place, sizesOf } from "./findings.js";
import { numbersOf } from "./result.js";
import { $, button, clear, el, fill, table, time, when } from "./dom.js";
import { ended } from "./spoken.js";
import { named, t } from "./texts.js";
import { who } from "./who.js";

export async function showHistory(cell, guarded, open) {
  /** @type {Api["ModelList"]} */
  const { history } = await get(`/cells/${cell.id}/models`);
  const changes = $("history-changes");
  const restore = (m) => guarded(async () => {
    if (!await ask(changes, { title: t("history.restore.title", { time: time(m.accepted) }), text: t("history.restore.what"), yes: t("history.restore") })) return;
    await post(`/cells/${cell.id}/models/${m.id}/restore`, who());
    await showHistory(cell, guarded, open);
  });
  const compare = (m) => guarded(async () => {
    // As the result does: either side is the mean of the accepted runs that agree with it.
    const answer = await get(`/cells/${cell.id}/changes?from=${m.id}&to=${history[0].id}&averaged=true`);
    changes.textContent = t("changes.since_time", { time: time(m.accepted), what: changeLines(answer).join(" ") });
  });
  clear(changes);
  table($("accepted"), [t("history.when"), t("history.model"), t("history.by"), ""], history.map((m, i) => ({ cells: [when(m.accepted), `…${m.id.slice(-8)}`, `${m.by} (${named("how", m.how)})`,
    i ? el("span", { class: "actions" }, [button(t("history.compare"), compare(m)), button(t("history.restore"), restore(m))]) : el("b", {}, t("history.now"))] })));
  /** @type {{ identifications: Run[] }} */
  const { identifications } = await get(`/identifications?cell=${cell.id}`);
  const said = (r) => (r.summary ? headline(r.summary) : r.error ? ended(r)[0] : "");
  table($("runs"), [t("history.started"), t("history.kind"), t("history.state"), t("history.result"), ""], identifications.map((r) => ({ cells: [when(r.created), named("mode", r.mode), t(`state.${r.state}`).split(":")[0],
    said(r), button(t("history.show"), () => open(r), { "aria-label": `${t("history.show")} ${when(r.created)}` })] })));
  await charts(cell, history, identifications);
}

async function charts(cell, history, identifications) {
  const newest = identifications.find((r) => r.summary && r.state !== "failed"), id = history[0]?.id ?? newest?.id;
  const model = id ? await get(`/cells/${cell.id}/models/${id}`).catch(() => null) : null;
  if (!model) { fill($("charts"), [el("p", { class: "quiet" }, t("history.empty"))]); return; }
  const groups = new Map(), sizes = sizesOf(model);
  const add = (group, name, label) => { if (!groups.has(group)) groups.set(group, new Map()); groups.get(group).set(name, label); };
  for (const n of numbersOf(model)) add(n.group, n.name, n.label);
  // Causes of any of these runs: one that is gone has a history too.
  for (const f of [...(model.effects ?? []), ...identifications.flatMap((r) => r.summary?.findings ?? [])]) {
    add(t("history.causes"), [f.axis, f.cause, f.element, f.other_axis].filter(Boolean).join("."), `${f.axis}: ${named("cause", f.cause)} ${place(f, sizes)}`.trim());
  }
  const causes = groups.get(t("history.causes"));
  if (causes) { groups.delete(t("history.causes")); groups.set(t("history.causes"), causes); }
  fill($("charts"), [...groups].map(([group, names]) => {
    const grid = el("div", { class: "grid" }), box = el("details", {}, [el("summary", {}, group), grid]);
    // Asked for when somebody looks: a cell has dozens of numbers.
    box.addEventListener("toggle", () => { if (box.open && !grid.childElementCount) draw(cell, names, grid); });
    return box;
  }));
}

async function draw(cell, names, grid) {
  fill(grid, [el("p", { class: "quiet" }, t("history.loading"))]);
  const figures = [];
  for (const [name, label] of names) {
    const path = `/cells/${cell.id}/series?parameter=${encodeURIComponent(name)}`;
    const series = await get(path).catch(() => null), chart = series && historyChart(label, series);
    if (!chart) continue;
    figures.push(el("figure", { "data-parameter": name }, [el("figcaption", {}, `${label}${series.unit ? ` [${series.unit}]` : ""}`), chart.picture,
      el("p", { class: "links" }, [el("a", { href: `${path}&format=csv`, "data-download": `${name}.csv`, "aria-label": t("history.csv", { name: label }) }, t("history.csv.short"))])]));
    fill(grid, figures);
  }
  if (!figures.length) fill(grid, [el("p", { class: "quiet" }, t("history.empty"))]);
}
