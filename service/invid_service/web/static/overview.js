// All cells at a glance: what each does, what its last run found, what changed.
import { get } from "./api.js";
import { changesLine, gradeBadge, headline } from "./findings.js";
import { $, button, el, fill, sentence, when } from "./dom.js";
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

// The cell's last run in the page's language, where it is told in full; else the service's own sentences.
function said(cell, { last_run: last, changed }) {
  const full = cell.last_identification, same = full && full.id === last?.id ? full : null, summary = same?.summary;
  const news = changed && summary?.changes ? changesLine(summary.changes, null) : changed;
  return {
    headline: summary ? headline(summary) : same?.stopped?.reason ?? last?.headline, news,
    time: when(last?.ended ?? full?.started ?? full?.created),
    native: { headline: english || summary, news: english || (summary?.changes && changed) },
  };
}

export async function showOverview(open) {
  const { cells } = await get("/cells");
  fill($("cells"), cells.map((cell) => {
    const view = summed(cell), last = view.last_run, { headline: found, news, time, native } = said(cell, view);
    return el("article", { class: "card", "data-cell": cell.id }, [
      el("h3", {}, [cell.name, cell.simulated ? el("small", { class: "quiet" }, ` ${t("run.simulated")}`) : null].filter(Boolean)),
      el("p", { class: `state ${view.state}` }, view.state === "awaiting_accept" ? sentence(t("phase.awaiting_accept")) : named("state", view.state).split(":")[0]),
      last ? el("p", {}, [el("small", { class: "quiet" }, t("overview.last", { time })), " ", last.grade ? gradeBadge(last.grade) : null].filter(Boolean)) : el("p", { class: "quiet" }, t("overview.never")),
      found ? el("p", { lang: native.headline ? null : "en" }, found) : null,
      last?.verdict ? el("p", { class: news ? "changed" : "quiet", lang: !news || native.news ? null : "en" }, news ?? t("overview.unchanged")) : null,
      button(t("overview.open", { cell: cell.name }), () => open(cell.id)),
    ]);
  }));
}
