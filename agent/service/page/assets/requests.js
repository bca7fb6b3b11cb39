/* Requests to the service. They carry the token if there is one; an abort needs none. */
import { say } from "./language.js";

const KEPT_AS = "volcal.token", PAIRED_AS = "volcal.paired";

/* A token that was typed goes with the window; that of a paired browser stays until it is revoked. */
export const token = () => sessionStorage.getItem(KEPT_AS) ?? localStorage.getItem(PAIRED_AS);
export const keepToken = (value) => (value ? sessionStorage.setItem(KEPT_AS, value) : sessionStorage.removeItem(KEPT_AS));

export function keepPaired(value) {
  sessionStorage.removeItem(KEPT_AS);
  localStorage.setItem(PAIRED_AS, value);
}

export function forgetToken() {
  sessionStorage.removeItem(KEPT_AS);
  localStorage.removeItem(PAIRED_AS);
}

/* Forgets the token in use, which the service has refused; one of a paired browser below a typed one stays. */
export function dropRefused() {
  if (sessionStorage.getItem(KEPT_AS) === null) localStorage.removeItem(PAIRED_AS);
  else sessionStorage.removeItem(KEPT_AS);
}

/* What no header can carry is no token; it must not keep an abort from being sent. */
const SENDABLE = /^[!-~]+$/;
const authorized = () => (SENDABLE.test(token() ?? "") ? { authorization: `Bearer ${token()}` } : {});

/* Refusal by the service. `problem`: its problem document (detail, hint, where, status). */
export class Refused extends Error {
  constructor(problem) {
    super(problem.detail ?? "");
    this.problem = problem;
  }
}

const YIELD_MS = 1000;
const reading = new Set();
let held = Promise.resolve();

/* Reads a document; `signal` breaks it off for good. */
export const read = (path, { withToken = false, signal } = {}) =>
  fetched(path, () => ({ accept: "application/json", ...(withToken ? authorized() : {}) }), asJson, signal);

/* Fetches a file that requires the token. */
export const fetchFile = (path) => fetched(path, authorized, (response) => response.blob());

/* A reading that `askFirst` has broken off is begun again, so that nobody misses what it was to bring. */
async function fetched(path, headers, content, signal) {
  for (;;) {
    await held;
    const controller = new AbortController();
    const stop = () => controller.abort();
    if (signal?.aborted) stop();
    signal?.addEventListener("abort", stop);
    reading.add(controller);
    try {
      return await answered(fetch(path, { headers: headers(), signal: controller.signal }), content);
    } catch (error) {
      if (!controller.signal.aborted || signal?.aborted) throw error;
    } finally {
      signal?.removeEventListener("abort", stop);
      reading.delete(controller);
    }
  }
}

/* Sends a request before all reading. Browsers open at most six connections to a host: an abort must not wait for
   responses that are being computed. Documents and files are broken off, and asked for again once the request has been
   answered. The stream of events and what `ask` has sent keep their connections: a request may have been carried out
   already. */
export async function askFirst(path, body) {
  let release;
  held = new Promise((resolve) => {
    release = resolve;
    setTimeout(resolve, YIELD_MS);
  });
  for (const controller of reading) controller.abort();
  try {
    return await ask(path, body);
  } finally {
    release();
  }
}

export async function ask(path, body) {
  const headers = { "content-type": "application/json", ...authorized() };
  return answered(fetch(path, { method: "POST", headers, body: JSON.stringify(body ?? {}) }), asJson);
}

/* True if the service does not accept the token at all; a role that does not permit the request is another matter. */
export const isTokenRefused = (error) => error instanceof Refused && (error.problem.status === 401 || (error.problem.status === 403 && error.problem.title !== "RoleRefused"));

const asJson = (response) => response.json();

/* Content of the response, read by `content`. A response that ends before its end is none: the service died in the middle
   of it, or the request was broken off. */
async function answered(request, content) {
  const whole = (part) => part.catch(() => {
    throw new Refused({ status: 0, detail: say("problem.no_answer") });
  });
  const response = await whole(request);
  if (response.ok) return whole(content(response));
  let problem = { status: response.status, detail: response.statusText };
  if ((response.headers.get("content-type") ?? "").includes("json")) problem = { ...problem, ...(await whole(asJson(response))) };
  throw new Refused(problem);
}
