/* Dialog that asks for a pairing code or, instead, for the token of the machine. */
import { accessText, isEngineer, leave, learnAccess, mayInvite, pairWith } from "./access.js";
import { asked } from "./dialogs.js";
import { byId, make } from "./dom.js";
import { inviteDevice } from "./invite-dialog.js";
import { known, say } from "./language.js";
import { keepToken, Refused, token } from "./requests.js";

/* Resolves with true once the page has a token, with false if the dialog is cancelled. `typing` shows the field for the
   token of the machine. */
export async function askAccess(why = "", typing = false) {
  const given = await asked(say("access.title"), say("access.confirm"), make("p", {}, why || say("access.why")), ...fields(typing), ...signedIn());
  if (given === null) return false;
  const typed = given.get("token").trim();
  if (typed) {
    keepToken(typed);
    await learnAccess();
    return token() === typed || askAccess(say("token.wrong"), true);
  }
  if (given.get("code") === null) return askAccess(say("token.wrong"), true);
  try {
    await pairWith(given.get("code").replaceAll(/\D/g, ""));
    return true;
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    return askAccess(reasonOf(error.problem));
  }
}

function signedIn() {
  const who = accessText();
  if (who === null) return [];
  const out = () => {
    leave();
    byId("dialog").close();
  };
  const invite = () => {
    byId("dialog").addEventListener("close", inviteDevice, { once: true });
    byId("dialog").close();
  };
  const others = mayInvite() ? [make("button", { type: "button", id: "invite", onclick: invite }, say("invite.open"))] : [];
  return [make("div", { className: "signed-in" }, make("b", {}, say("access.now", { who })), make("div", { className: "acts" }, ...others,
    make("button", { type: "button", id: "leave", onclick: out }, say("access.leave"))),
    isEngineer() && !mayInvite() ? make("small", { className: "remark" }, say("invite.needs_machine")) : null)];
}

/* One of the two is needed: the code unless the field for the token is shown. */
function fields(typing) {
  const code = make("input", { name: "code", className: "code", required: true, inputMode: "numeric", autocomplete: "one-time-code", pattern: "[0-9]{3} ?[0-9]{3}", maxLength: 7 });
  const field = make("input", { type: "password", name: "token", autocomplete: "off" });
  const instead = make("details", {}, make("summary", {}, say("access.token_instead")), make("label", {}, say("token.name"), field),
    make("p", { className: "remark" }, say("access.token_kept")));
  instead.addEventListener("toggle", () => {
    [code.required, field.required] = [!instead.open, instead.open];
    code.disabled = instead.open;
    (instead.open ? field : code).focus();
  });
  instead.open = typing;
  return [make("label", {}, say("access.code"), code), instead];
}

const reasonOf = ({ title, status, detail }) => {
  const own = [`problem.${title}`, `problem.${status}`].find(known);
  return own ? say(own) : detail;
};
