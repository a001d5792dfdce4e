// Calls to the service, each with a time-out. The key, where one is needed, stays in this tab and never goes into an address.
import { learn } from "./said.js";

const BASE = new URL("../api/v1", import.meta.url).pathname; // a reverse proxy may show the service under a path
const KEY = "invid-key", PATIENCE_MS = 20000, LONG_MS = 900000;

export class Problem extends Error {
  constructor(status, document) { super(document.detail || document.title || "the service refused"); this.status = status; this.document = document; }
}

/** @type {(problem: Problem) => void} */
let keyRefused = () => {};
/** @param {(problem: Problem) => void} work */
export function onKeyRefused(work) { keyRefused = work; }
export function useKey(key) { if (key) sessionStorage.setItem(KEY, key); else sessionStorage.removeItem(KEY); }

export async function call(method, path, body, extra = {}, patience = PATIENCE_MS) {
  const raw = body instanceof Blob || body instanceof FormData, key = sessionStorage.getItem(KEY), limit = new AbortController();
  setTimeout(() => limit.abort(), raw ? LONG_MS : patience); // holds for the body of the answer too
  const response = await fetch(path.startsWith(BASE) ? path : BASE + path, {
    method, cache: "no-store", signal: limit.signal,
    headers: { "X-Requested-With": "invid", ...(key ? { Authorization: `Bearer ${key}` } : {}), ...(body && !raw ? { "Content-Type": "application/json" } : {}), ...extra },
    body: body === undefined ? undefined : raw ? body : JSON.stringify(body),
  });
  if (response.ok) return response;
  const problem = new Problem(response.status, await read(response).catch(() => ({ detail: `${response.status} ${response.statusText}` })));
  if (problem.status === 401) keyRefused(problem);
  throw problem;
}

export const read = async (response) => JSON.parse(await response.text(), learn);
export const get = async (path, patience) => read(await call("GET", path, undefined, {}, patience));
export const post = async (path, body, extra, patience) => read(await call("POST", path, body, extra, patience));

export async function download(path, name) {
  const blob = await (await call("GET", path, undefined, {}, LONG_MS)).blob();
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}
