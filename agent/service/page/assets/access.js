/* Who this page is to the service: name and role of its token, and the requests that they permit. */
import { say } from "./language.js";
import { showDone, showProblem } from "./notices.js";
import { ask, dropRefused, forgetToken, keepPaired, read, Refused, token } from "./requests.js";

const NOBODY = { role: null, name: "", may: null };
const PAIRING = /^#pair=([0-9]{6})$/;
const listeners = new Set();
let now = NOBODY, known = null; // known: the token that `now` belongs to

export const onAccess = (listener) => listeners.add(listener);

/* Without a token nothing is withheld: the request asks for one. */
export const permits = (request) => now.may === null || now.may.includes(request);

/* Only the token of the machine, which belongs to nobody in particular, pairs other devices. */
export const mayInvite = () => now.role !== null && !now.name;
export const isEngineer = () => now.role === "engineer";

/* Role in words and name, null without a token. */
export function accessText() {
  if (now.role === null) return null;
  const role = say(`role.${now.role}`);
  return now.name ? `${role} · ${now.name}` : role;
}

/* Asks the service who this page is; a token that it does not accept any more is forgotten. */
export async function learnAccess() {
  const asked = token();
  if (asked !== known) [now, known] = [NOBODY, asked]; // who had another token is not who has this one
  try {
    now = token() ? await read("/api/access", { withToken: true }) : NOBODY;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (![401, 403].includes(error.problem.status)) return tell();
    dropRefused();
    now = NOBODY;
    if (token()) return learnAccess();
  }
  tell();
}

/* Exchanges a code for a token of this browser, which it keeps until it is revoked. */
export async function pairWith(code) {
  const { token: given, ...access } = await ask("/api/pair", { code });
  keepPaired(given);
  [now, known] = [access, given];
  tell();
}

export function leave() {
  forgetToken();
  [now, known] = [NOBODY, null];
  tell();
}

const tell = () => listeners.forEach((listener) => listener());

/* The address in the QR code ends with the pairing code; it is taken out of the address at once. */
async function takeCode() {
  const found = PAIRING.exec(location.hash);
  if (!found) return;
  history.replaceState(null, "", "/");
  try {
    await pairWith(found[1]);
    showDone("access.paired");
  } catch (error) {
    showProblem(error);
  }
}

export async function openAccess() {
  addEventListener("hashchange", takeCode);
  await learnAccess();
  await takeCode();
}
