import { openControls } from "./controls.js";
import { openFrame } from "./frame.js";
import { loadWords } from "./language.js";
import { openOperator } from "./operator.js";
import { follow } from "./store.js";
import { openTheme } from "./theme.js";

await loadWords();
openTheme();
openFrame(() => {});
openControls();
openOperator();
await follow();
