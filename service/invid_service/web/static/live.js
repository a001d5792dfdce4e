// The response as it grows while the robot moves: the last experiment of each axis, every axis with a colour and dash of its own.
import { events } from "./api.js";
import { $ } from "./dom.js";
import { curves } from "./plots.js";
import { t } from "./texts.js";

const HUES = ["--after", "--before", "--third"], EVERY_MS = 2000;
const seen = { run: null, last: "0", at: 0, of: new Map() };

/** @param {Run} run */
export async function showLive(run, axes) {
  if (seen.run !== run.id) Object.assign(seen, { run: run.id, last: "0", at: 0, of: new Map() });
  if (Date.now() - seen.at < EVERY_MS) return;
  seen.at = Date.now();
  const news = await events(run.links.events, seen.last).catch(() => []);
  if (seen.run !== run.id || !news.length) return;
  seen.last = news.at(-1).id;
  const responses = news.filter((e) => e.type === "response").map((e) => e.data);
  for (const r of responses) r.db.forEach((y, i) => y && seen.of.set(i, { n: Number(r.experiment) + 1, x: r.frequency_hz, y }));
  if (responses.length) draw(axes);
}

function draw(axes) {
  const series = [...seen.of].sort(([a], [b]) => a - b).map(([i, { n, x, y }]) => ({
    label: t("run.live.series", { axis: axes[i] ?? i, n }), x, y, colour: HUES[i % 3], dash: (i + Math.floor(i / 3)) % 3 }));
  $("live").hidden = !series.length;
  const alt = t("run.live.alt", { n: series.length, what: series.map((s) => s.label).join(", ") });
  curves($("live-plot"), { x: t("chart.frequency"), y: t("run.live.y"), series, logY: false, alt });
}

export function clearLive() { Object.assign(seen, { run: null }); $("live").hidden = true; }
