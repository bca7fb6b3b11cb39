/* State of the set-up as the service last sent it, and requests that change it. */
import { askToken } from "./dialogs.js";
import { addWords, known, say } from "./language.js";
import { hide, showProblem } from "./notices.js";
import { ask, read, Refused, token } from "./requests.js";
import { inPageWords, prose, sentences } from "./setup-words.js";

/* `refusal` is the problem for which the review of the present statements was refused. */
export const seen = { now: null, fields: [], steps: [], finished: false, refusal: null };
const listeners = new Set();
let last = Promise.resolve();

export const onState = (listener) => listeners.add(listener);

export async function load() {
  const { fields, steps, words } = await read("/api/setup/fields");
  addWords(words);
  Object.assign(seen, { fields, steps: [...steps, "review"] });
  take(await read("/api/setup"));
}

function take(document) {
  [seen.now, seen.refusal] = [document, null];
  for (const listener of listeners) listener();
}

/* Statuses of a refusal that is not about the statements: without a valid token, or not allowed in this state. */
const NOT_ABOUT_STATEMENTS = [401, 403, 409];

/* Sends a request with the token and returns its answer, null if it was refused; one request after the other.
   `refused` is called with the problem of a refusal of the statements; by default a notice shows it. */
export function send(path, body = {}, refused = null) {
  const answer = last.then(() => sent(path, body, refused));
  last = answer.catch(() => null);
  return answer;
}

/* Sends a request whose answer is the whole state. */
export async function change(path, body, refused = null) {
  const document = await send(path, body, refused);
  if (document) take(document);
  return document !== null;
}

export const settled = () => last;

async function sent(path, body, refused) {
  if (!token() && !(await askToken(say("setup.token_why")))) return null;
  try {
    const answer = await ask(`/api/setup/${path}`, body);
    hide();
    return answer;
  } catch (error) {
    if (error instanceof Refused && [401, 403].includes(error.problem.status)) {
      if (await askToken(say("setup.token_why"))) return sent(path, body, refused);
    }
    if (refused && error instanceof Refused && !NOT_ABOUT_STATEMENTS.includes(error.problem.status)) refused(inWords(error).problem);
    else showProblem(inWords(error), inProse);
    return null;
  }
}

const inProse = (text) => prose(inPageWords(text));

/* The error with the words of its alarm, which are in both languages, before those of the service. */
function inWords(error) {
  const { code, detail, hint } = error.problem ?? {};
  if (known(`alarm.${code}`)) error.problem = { ...error.problem, detail: say(`alarm.${code}`), hint: sentences(detail, hint) };
  return error;
}

/* Asks `path` again and again while `wanted()`, and hands each answer to `shown`; a refusal ends it. */
export async function poll(path, wanted, shown) {
  while (wanted()) {
    try {
      shown(await read(`/api/setup/${path}`));
    } catch (error) {
      if (wanted()) showProblem(inWords(error), inProse);
      return;
    }
    await new Promise((resolve) => setTimeout(resolve, 300));
  }
}
