// Talking with the server: lost connections are tried again by themselves, refusals are told in words.

import { find, pause, write } from "./dom.js";

const WAITS = [500, 1000, 2000, 4000]; // milliseconds between attempts

/** The server answered, and its answer is no. */
export class Refused extends Error {
  constructor(words, status) {
    super(words);
    this.status = status;
  }
}

const USUAL = "Connection lost, trying again";
let lost = 0; // requests that wait for an answer

function losing(by, why) {
  lost += by;
  const note = find("lost");
  if (note) note.hidden = lost <= 0;
  write(note, why);
}

async function words(response, otherwise) {
  try {
    const body = await response.json();
    if (body && typeof body.error === "string") return body.error;
  } catch {
    // no words came with it
  }
  return otherwise;
}

async function attempt(path, options) {
  let response;
  try {
    response = await fetch(path, { ...options, credentials: "same-origin", cache: "no-store" });
  } catch {
    return {}; // no connection
  }
  if (response.status === 503) return { why: await words(response, USUAL) }; // as of a disk that is full
  if ([502, 504].includes(response.status)) return {};
  if (response.status === 401) {
    location.assign(`/enter?next=${encodeURIComponent(location.pathname)}`);
    return new Promise(() => {});
  }
  if (!response.ok) {
    const no = response.status === 404 ? "This is not there (any more)." : `The server said no (${response.status}).`;
    throw new Refused(await words(response, no), response.status);
  }
  try {
    return { body: await response.json() };
  } catch {
    return {}; // cut off in the middle
  }
}

async function call(path, options) {
  let counted = false;
  try {
    for (let i = 0; ; i++) {
      const got = await attempt(path, options);
      if (got.body) return got.body;
      losing(counted ? 0 : 1, got.why ?? USUAL);
      counted = true;
      await pause(WAITS[Math.min(i, WAITS.length - 1)]);
    }
  } finally {
    if (counted) losing(-1, USUAL);
  }
}

/** What can be asked about one run. */
export function api(run) {
  const base = `/api/runs/${encodeURIComponent(run)}`;
  const get = (path, query = {}) => {
    const tail = new URLSearchParams(query).toString();
    return call(`${base}/${path}${tail ? `?${tail}` : ""}`, {});
  };
  const post = (path, body) => call(`${base}/${path}`, {
    method: "POST", headers: { "Content-Type": "application/json", "X-Hiprl": "1" }, body: JSON.stringify(body),
    keepalive: true, // it arrives, though the page is closed at once
  });
  return {
    scene: () => get("scene"),
    next: (judge) => get("next", { judge }),
    last: (judge) => get("last", { judge }),
    now: () => get("now"),
    answers: () => get("answers"),
    question: (k) => get(`questions/${Number(k)}`),
    facts: () => get("facts"),
    answer: (body) => post("answers", body),
    goal: (goal) => post("goal", { goal }),
    enough: (judge) => post("enough", { judge }),
    events: (each) => listen(`${base}/events`, each),
  };
}

/** Calls `each(progress)` at every change, while the page is looked at. */
function listen(path, each) {
  let source = null, again = 0;
  const open = () => {
    clearTimeout(again);
    source?.close();
    source = new EventSource(path);
    source.addEventListener("progress", (event) => {
      try {
        each(JSON.parse(event.data));
      } catch {
        // a line that is no progress
      }
    });
    source.addEventListener("error", () => {
      if (source?.readyState === EventSource.CLOSED) again = setTimeout(open, 5000);
    });
  };
  const shut = () => {
    clearTimeout(again);
    source?.close();
    source = null;
  };
  document.addEventListener("visibilitychange", () => (document.hidden ? shut() : open()));
  addEventListener("pagehide", shut);
  if (!document.hidden) open();
}
