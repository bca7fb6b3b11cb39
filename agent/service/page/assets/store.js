/* State of the page: status, measurements and events of the current run, time of the last message. */
import { read, Refused } from "./requests.js";

const EVENTS_KEPT = 500;
const KINDS = ["state", "progress", "note", "gate", "ball", "lost", "temperature", "question", "alarm", "outcome"];
const QUIET = new Set(["progress", "temperature", "ball"]);
const POLL_MS = 1000;
const SOON_MS = 150;
const SILENT_MS = 4000, NOT_FOUND = 404;
/* An answer that is older than the one before was overtaken on its way; after this time it is of a service that was started again. */
const OVERTAKEN_MS = 2000;
const FIRST_WAIT_MS = 1000, MOST_WAIT_MS = 30000, ANSWER_MS = 60000;

export const seen = { status: null, balls: [], lost: [], temperatures: [], events: [], lastMessage: Date.now(), stale: false };
const listeners = new Map();
let waiting = false, asking = false, unread = false, reading = false;
let taken = 0; // when the status was taken
let runHeard = null; // run of the last state event or status
let breakOff = () => {}; // ends the reading of the run, or the wait for its next one

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
    takeStatus(await read("/api/status"));
  } catch {
    checkSilence();
  } finally {
    asking = false;
  }
}

function takeStatus(status) {
  const former = seen.status;
  seen.lastMessage = Date.now();
  setStale(false);
  if (former && status.event < former.event && Date.now() - taken < OVERTAKEN_MS && status.run_id === former.run_id && status.state === former.state) return;
  seen.status = status;
  taken = Date.now();
  if (former?.run_id !== status.run_id) {
    Object.assign(seen, { balls: [], lost: [], temperatures: [] });
    unread = status.run_id !== null;
    breakOff();
    notify("run", status.run_id);
  }
  runHeard = status.run_id;
  notify("status", status);
  if (unread) readRuns();
}

/* Reads what the journal has of the run, one reading at a time, until it has been read. What is read in vain is asked for
   again after 1, 2, 4 … 30 s; another run is read at once. */
async function readRuns() {
  if (reading) return;
  reading = true;
  try {
    for (let run, wait = FIRST_WAIT_MS; unread; wait = Math.min(2 * wait, MOST_WAIT_MS)) {
      if (run !== seen.status.run_id) wait = FIRST_WAIT_MS;
      run = seen.status.run_id;
      await readRun(run);
      if (unread && seen.status.run_id === run) await pause(wait);
    }
  } finally {
    reading = false;
  }
}

/* Adds what the journal has of the run to what has happened since. */
async function readRun(run) {
  const path = `/api/runs/${encodeURIComponent(run)}`, breaking = new AbortController();
  breakOff = () => breaking.abort();
  const limit = setTimeout(breakOff, ANSWER_MS);
  const [balls, events] = await Promise.all([`${path}/balls`, `${path}/events?limit=1000`].map((part) => known(part, breaking.signal)));
  clearTimeout(limit);
  if (seen.status.run_id !== run) return;
  unread = balls === null || events === null;
  seen.balls = merged(balls ?? [], seen.balls);
  if (events) {
    seen.events = withRecorded(run, events.filter(({ kind }) => kind === "state" || kind === "note"));
    seen.lost = merged(events.filter(({ record }) => record.step?.endsWith("/lost")).map(({ record }) => ({ key: record.step, reason: record.reason })), seen.lost);
  }
  notify("run", run);
  notify("event", null);
}

const pause = (ms) => new Promise((resolve) => {
  breakOff = resolve;
  setTimeout(resolve, ms);
});

/* Events, the latest first, with the `rows` that the journal has of `run`. The numbers of the journal are not those of the
   stream of events, so that what is in both is known by its words. What is in the journal alone happened before the page
   heard of the run. */
function withRecorded(run, rows) {
  const heard = seen.events.filter((event) => event.run === run && !event.recorded);
  const left = heard.map(sameWords);
  const before = rows.map((row) => ({ ...asEvent(row), run, recorded: true })).reverse().filter((event) => {
    const place = left.indexOf(sameWords(event));
    if (place < 0) return true;
    left[place] = null;
    return false;
  });
  return [...heard, ...before, ...seen.events.filter((event) => event.run !== run)].slice(0, EVENTS_KEPT);
}

const sameWords = ({ kind, text, data }) => `${kind}: ${kind === "state" ? data.state : text}`;

/* What was there before, followed by what is new in `later`. */
const merged = (former, later) => [...former, ...later.filter(({ key }) => !former.some((one) => one.key === key))];

const asEvent = ({ number, at, kind, record }) => ({ number, at, kind, text: record.text ?? "", data: record });

/* A run that has just started is not in the journal yet. Null if the service did not answer. */
async function known(path, signal) {
  try {
    return await read(path, { signal });
  } catch (error) {
    return error instanceof Refused && error.problem.status === NOT_FOUND ? [] : null;
  }
}

function happened(kind, message) {
  const { text, data } = JSON.parse(message.data);
  if (kind === "state") runHeard = data.run_id ?? null;
  const event = { number: Number(message.lastEventId), kind, text, data, at: new Date().toISOString(), run: runHeard };
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
