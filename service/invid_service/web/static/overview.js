// All cells at a glance: what each does, what its last run found, what changed.
import { get } from "./api.js";
import { gradeBadge } from "./findings.js";
import { $, button, el, fill, when } from "./dom.js";
import { english, named, t } from "./texts.js";

// A service that has no overview yet still knows the last run.
function summed(cell) {
  if (cell.overview) return cell.overview;
  const last = cell.last_identification;
  return {
    state: last?.state ?? "ready",
    last_run: last && { id: last.id, state: last.state, ended: last.ended, verdict: last.summary?.verdict, headline: last.summary?.headline ?? last.error?.text, grade: last.summary?.grade },
    changed: null,
  };
}

export async function showOverview(open) {
  const { cells } = await get("/cells");
  fill($("cells"), cells.map((cell) => {
    const { state, last_run: last, changed } = summed(cell);
    const said = last && (english || !last.verdict ? last.headline : last.verdict && t(`verdict.${last.verdict}`));
    return el("article", { class: "card", "data-cell": cell.id }, [
      el("h3", {}, [cell.name, cell.simulated ? el("small", { class: "quiet" }, ` ${t("run.simulated")}`) : null].filter(Boolean)),
      el("p", { class: `state ${state}` }, named("state", state)),
      last ? el("p", {}, [el("small", { class: "quiet" }, `${t("overview.last", { time: when(last.ended) || named("state", last.state) })} `), last.grade ? gradeBadge(last.grade) : null].filter(Boolean)) : el("p", { class: "quiet" }, t("overview.never")),
      said ? el("p", { lang: english || last.verdict ? null : "en" }, said) : null,
      last?.verdict ? el("p", { class: changed ? "changed" : "quiet", lang: changed ? "en" : null }, changed ? t("overview.changed", { what: changed }) : t("overview.unchanged")) : null,
      button(t("overview.open", { cell: cell.name }), () => open(cell.id)),
    ]);
  }));
}
