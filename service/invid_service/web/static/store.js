// What the service said last of every cell, and when: all that the page shows of a cell's state is drawn from here.
import { get } from "./api.js";

const EVERY_MS = 1000, BUSY_MS = 400, PATIENCE_MS = 3000, QUIET_S = 5;
const BUSY = ["queued", "checking", "awaiting_arm", "running", "analysing"], TROUBLE = ["stopped", "failed", "interrupted"];
/** @type {{ cells: Now[], heard: number, failure: Error | null }} */
export const known = { cells: [], heard: Date.now(), failure: null };
export const find = (cell) => known.cells.find((c) => c.cell === cell);
/** @param {Now} c */
export const busy = (c) => BUSY.includes(c.state);
/** @param {Now} c */
export const troubled = (c) => TROUBLE.includes(c.state);
export const age = () => (Date.now() - known.heard) / 1000;
// Beyond this nothing is known of any cell.
export const blind = () => age() > QUIET_S;

const readers = [];
export const onState = (draw) => readers.push(draw);
const tell = (news) => { for (const draw of readers) draw(news); };

let looking = false, wanted = false, timer = 0;
// Ask now; who asks while an answer is awaited gets the one after it.
export async function look() {
  if (looking) { wanted = true; return; }
  clearTimeout(timer);
  looking = true;
  try {
    Object.assign(known, { cells: (await get("/state", PATIENCE_MS)).cells, heard: Date.now(), failure: null });
  } catch (error) { known.failure = error; }
  looking = false;
  tell(!known.failure);
  timer = setTimeout(look, wanted ? 0 : known.cells.some(busy) ? BUSY_MS : EVERY_MS);
  wanted = false;
}
setInterval(() => tell(false), 1000); // silence has an age too
document.addEventListener("visibilitychange", () => { if (!document.hidden) look(); });
