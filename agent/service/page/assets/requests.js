/* Requests to the service. Commands that move or write carry the token; abort carries none. */
import { say } from "./language.js";

const KEPT_AS = "volcal.token";

export const token = () => sessionStorage.getItem(KEPT_AS);
export const keepToken = (value) => (value ? sessionStorage.setItem(KEPT_AS, value) : sessionStorage.removeItem(KEPT_AS));

/* Refusal by the service. `problem`: its problem document (detail, hint, where, status). */
export class Refused extends Error {
  constructor(problem) {
    super(problem.detail ?? "");
    this.problem = problem;
  }
}

const reading = new Set();

export async function read(path) {
  const controller = new AbortController();
  reading.add(controller);
  try {
    return await (await answered(fetch(path, { headers: { accept: "application/json" }, signal: controller.signal }))).json();
  } finally {
    reading.delete(controller);
  }
}

/* Browsers open at most six connections to a host: an abort must not wait for responses that are being computed. */
export function dropReading() {
  for (const controller of reading) controller.abort();
}

export async function ask(path, body, { withToken = true } = {}) {
  const headers = { "content-type": "application/json" };
  if (withToken && token()) headers.authorization = `Bearer ${token()}`;
  return (await answered(fetch(path, { method: "POST", headers, body: JSON.stringify(body ?? {}) }))).json();
}

/* Fetches a file that requires the token. */
export async function fetchFile(path) {
  return (await answered(fetch(path, { headers: { authorization: `Bearer ${token()}` } }))).blob();
}

async function answered(request) {
  const response = await request.catch(() => {
    throw new Refused({ status: 0, detail: say("problem.no_answer") });
  });
  if (response.ok) return response;
  let problem = { status: response.status, detail: response.statusText };
  if ((response.headers.get("content-type") ?? "").includes("json")) problem = { ...problem, ...(await response.json()) };
  throw new Refused(problem);
}
