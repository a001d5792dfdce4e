// Calls to the service. The key, where one is needed, stays in this tab and never goes into an address.
const BASE = new URL("../api/v1", import.meta.url).pathname; // a reverse proxy may show the service under a path

export class Problem extends Error {
  constructor(document) { super(document.detail || document.title || "the service refused"); this.document = document; }
}

let askForKey = async () => null;
export function onKeyNeeded(ask) { askForKey = ask; }

function headers(extra) {
  const key = sessionStorage.getItem("invid-key");
  return { ...(key ? { Authorization: `Bearer ${key}` } : {}), ...extra };
}

export async function call(method, path, body, extra = {}) {
  const raw = body instanceof Blob;
  const response = await fetch(path.startsWith(BASE) ? path : BASE + path, {
    method, cache: "no-store",
    headers: headers({ ...(body && !raw ? { "Content-Type": "application/json" } : {}), ...extra }),
    body: body === undefined ? undefined : raw ? body : JSON.stringify(body),
  });
  if (response.status === 401) {
    const key = await askForKey();
    if (key) { sessionStorage.setItem("invid-key", key); return call(method, path, body, extra); }
  }
  if (!response.ok) {
    let document = {};
    try { document = await response.json(); } catch { document = { detail: `${response.status} ${response.statusText}` }; }
    throw new Problem(document);
  }
  return response;
}

export const get = async (path) => (await call("GET", path)).json();
export const post = async (path, body, extra) => (await call("POST", path, body, extra)).json();

export async function download(path, name) {
  const blob = await (await call("GET", path)).blob();
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60000);
}

// Server-sent events by fetch, because EventSource cannot send a key. Resumes with Last-Event-ID.
export async function follow(path, heard, wanted) {
  let last = "0";
  while (wanted()) {
    try {
      const response = await call("GET", path, undefined, { "Last-Event-ID": last });
      const reader = response.body.getReader(), decoder = new TextDecoder();
      let text = "";
      for (;;) {
        const { done, value } = await reader.read();
        if (done) return;
        if (!wanted()) { reader.cancel(); return; }
        text += decoder.decode(value, { stream: true });
        const blocks = text.split("\n\n");
        text = blocks.pop();
        for (const block of blocks) {
          const event = { type: "message", data: "" };
          for (const line of block.split("\n")) {
            if (line.startsWith("id: ")) last = line.slice(4);
            else if (line.startsWith("event: ")) event.type = line.slice(7);
            else if (line.startsWith("data: ")) event.data += line.slice(6);
          }
          if (event.data) heard(event.type, JSON.parse(event.data));
        }
      }
    } catch (error) {
      if (error instanceof Problem) return;
      await new Promise((r) => setTimeout(r, 1000));
    }
  }
}
