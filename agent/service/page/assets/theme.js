/* Light or dark theme: as set in the system until the user chooses. */
import { byId } from "./dom.js";

const KEPT_AS = "volcal.theme";
const system = matchMedia("(prefers-color-scheme: dark)");
const listeners = new Set();

export const onTheme = (listener) => listeners.add(listener);
export const dark = () => document.documentElement.dataset.theme === "dark";

export function openTheme() {
  apply(localStorage.getItem(KEPT_AS) ?? (system.matches ? "dark" : "light"));
  system.addEventListener("change", () => localStorage.getItem(KEPT_AS) ?? apply(system.matches ? "dark" : "light"));
  byId("theme").addEventListener("click", () => {
    const wished = dark() ? "light" : "dark";
    localStorage.setItem(KEPT_AS, wished);
    apply(wished);
  });
}

function apply(theme) {
  document.documentElement.dataset.theme = theme;
  byId("theme").textContent = theme === "dark" ? "☀" : "☾";
  for (const listener of listeners) listener();
}
