/* State of the page: status, measurements and events of the current run, time of the last message. */
import { read, Refused } from "./requests.js";

const EVENTS_KEPT = 500;
const KINDS = ["state", "progress", "note", "gate", "ball", "lost", "temperature", "question", "alarm", "outcome"];
const QUIET = new Set(["progress", "temperature", "ball"]);
const POLL_MS = 1000;
const SOON_MS = 150;
const SILENT_MS = 4000, NOT_FOUND = 404;

export const seen = { status: null, balls: [], lost: [], temperatures: [], events: [], lastMessage: Date.now(), stale: false };
const listeners = new Map();
let waiting = false, asking = false, unread = false;

/* `kind`: "status", "ball" (measured or lost), "event", "stale" or "run". */
export function on(kind, listener) {
  listeners.set(kind, [...(listeners.get(kind) ?? []), listener]);
}

const notify = (kind, what) => (listeners.get(kind) ?? []).forEach((listener) => listener(what));

export async function follow() {
  await refresh();
  const stream = new EventSource("/api/events");
  stream.addEventListener("status", (message) => takeStatus(JSON.parse(message.data)));
  for (const kind of KINDS) stream.addEventListener(kind, (message) => happened(kind, message));
  setInterval(watch, POLL_MS);
}

/* Events report that something has changed; the status is then fetched. */
export async function refresh() {
  if (asking) return;
  asking = true;
  try {
    await takeStatus(await read("/api/status"));
  } catch {
    checkSilence();
  } finally {
    asking = false;
  }
}

async function takeStatus(status) {
  const former = seen.status;
  seen.lastMessage = Date.now();
  setStale(false);
  if (former && status.event < former.event && status.run_id === former.run_id && status.state === former.state) return;
  seen.status = status;
  if (former?.run_id !== status.run_id) {
    Object.assign(seen, { balls: [], lost: [], temperatures: [] });
    unread = true;
    notify("run", status.run_id);
  }
  if (unread) await readRun(status.run_id);
  notify("status", status);
}

/* Adds what the journal has of the run to what has happened since; if it cannot be read, it is asked for again with
   the next status. */
async function readRun(run) {
  const path = `/api/runs/${encodeURIComponent(run)}`;
  const [balls, events] = run ? await Promise.all([known(`${path}/balls`), known(`${path}/events?limit=1000`)]) : [[], []];
  if (seen.status.run_id !== run) return;
  unread = balls === null || events === null;
  seen.balls = merged(balls ?? [], seen.balls);
  if (run && events) {
    seen.events = events.filter(({ kind }) => kind === "state" || kind === "note").map(asEvent).reverse().slice(0, EVENTS_KEPT);
    seen.lost = merged(events.filter(({ record }) => record.step?.endsWith("/lost")).map(({ record }) => ({ key: record.step, reason: record.reason })), seen.lost);
  }
  notify("run", run);
  notify("event", null);
}

/* What was there before, followed by what is new in `later`. */
const merged = (former, later) => [...former, ...later.filter(({ key }) => !former.some((one) => one.key === key))];

const asEvent = ({ number, at, kind, record }) => ({ number, at, kind, text: record.text ?? "", data: record });

/* A run that has just started is not in the journal yet. Null if the service did not answer. */
async function known(path) {
  try {
    return await read(path);
  } catch (error) {
    return error instanceof Refused && error.problem.status === NOT_FOUND ? [] : null;
  }
}

function happened(kind, message) {
  const { text, data } = JSON.parse(message.data);
  const event = { number: Number(message.lastEventId), kind, text, data, at: new Date().toISOString() };
  seen.lastMessage = Date.now();
  if (kind === "ball" && !seen.balls.some((ball) => ball.key === data.key)) {
    seen.balls.push(data);
    notify("ball", data);
  }
  if (kind === "lost") {
    seen.lost.push({ key: text, reason: data.reason });
    notify("ball", data);
  }
  if (kind === "temperature") seen.temperatures.push({ key: text, ...data });
  if (!QUIET.has(kind)) {
    seen.events.unshift(event);
    seen.events.length = Math.min(seen.events.length, EVENTS_KEPT);
    notify("event", event);
  }
  if (waiting) return;
  waiting = true;
  setTimeout(async () => {
    await refresh();
    waiting = false;
  }, SOON_MS);
}

/* A service that hangs does not respond at all: missing messages count, not errors. */
function watch() {
  checkSilence();
  refresh();
}

const checkSilence = () => setStale(Date.now() - seen.lastMessage > SILENT_MS);

function setStale(stale) {
  const changed = seen.stale !== stale;
  seen.stale = stale;
  if (changed || stale) notify("stale", stale);
}
