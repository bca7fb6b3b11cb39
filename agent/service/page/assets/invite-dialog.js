/* Dialogs with which the owner of the token of the machine pairs another device: role and name, then QR code and digits. */
import { asked, shown } from "./dialogs.js";
import { make } from "./dom.js";
import { say, timeOfDay } from "./language.js";
import { showProblem } from "./notices.js";
import { ask, Refused } from "./requests.js";

const ROLES = ["operator", "engineer"];

export async function inviteDevice() {
  const role = (name, i) => make("label", { className: "check" }, make("input", { type: "radio", name: "role", value: name, checked: i === 0 }),
    make("span", {}, make("b", {}, say(`role.${name}`)), " ", say(`invite.may_${name}`)));
  const name = make("label", {}, say("invite.name"), make("input", { name: "name", maxLength: 40, autocomplete: "off" }));
  const given = await asked(say("invite.title"), say("invite.confirm"), make("div", { role: "radiogroup", ariaLabel: say("invite.role") }, ...ROLES.map(role)), name);
  if (given === null) return;
  try {
    await show(await ask("/api/pairing/code", { role: given.get("role"), name: given.get("name").trim() || null }));
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    showProblem(error);
  }
}

function show({ code, ends, role, name, address, picture, reachable }) {
  return shown(say("invite.title"), make("p", {}, say("invite.scan")), make("div", { className: "invitation" },
    make("img", { src: picture, alt: say("invite.picture", { address }) }),
    make("div", {}, make("span", {}, say("invite.code")), make("span", { className: "digits", id: "invitation-code" }, `${code.slice(0, 3)} ${code.slice(3)}`),
      make("span", {}, say("invite.valid", { who: `${say(`role.${role}`)} · ${name}`, until: timeOfDay(ends) })), make("small", {}, address))),
    reachable ? null : make("p", { className: "remark" }, say("invite.loopback")));
}
