import { openAccess } from "./access.js";
import { openControls } from "./controls.js";
import { enterEngineer, leaveEngineer, openEngineer } from "./engineer.js";
import { openFrame } from "./frame.js";
import { loadWords } from "./language.js";
import { loadSentences } from "./sentences.js";
import { openOperator } from "./operator.js";
import { follow } from "./store.js";
import { openTheme } from "./theme.js";

await Promise.all([loadWords("verdicts.json", "records.json"), loadSentences()]);
openTheme();
openFrame((view) => (view === "engineer" ? enterEngineer() : leaveEngineer()));
openControls();
openOperator();
openEngineer();
await Promise.all([follow(), openAccess()]);
