/* Form deviation of each ball as it is measured: a dirty or loose ball is noticed at once. */
import { draw, make } from "./dom.js";
import { number, onLanguage, say } from "./language.js";
import { on, seen } from "./store.js";

const SHOWN = 60;
const WIDTH = 400, HEIGHT = 120, LEFT = 34, BELOW = 6, LEAST_UM = 4;

export function openResiduals(section) {
  const title = make("h2"), picture = draw("svg", { viewBox: `0 0 ${WIDTH} ${HEIGHT}`, role: "img" });
  section.replaceChildren(title, picture);
  const show = () => {
    section.hidden = !seen.balls.length;
    title.textContent = say("residuals.title");
    picture.setAttribute("aria-label", say("residuals.name", { count: seen.balls.length }));
    picture.replaceChildren(...bars(seen.balls.slice(-SHOWN)));
  };
  show();
  for (const kind of ["ball", "run"]) on(kind, show);
  onLanguage(show);
}

function bars(balls) {
  const values = balls.map((ball) => 1000 * ball.form_mm);
  const highest = Math.max(LEAST_UM, ...values) * 1.1;
  const y = (value) => (HEIGHT - BELOW) * (1 - value / highest);
  const step = (WIDTH - LEFT) / SHOWN;
  const lines = [0, highest / 2.2, highest / 1.1].flatMap((value) => [
    draw("line", { x1: LEFT, x2: WIDTH, y1: y(value), y2: y(value), stroke: "var(--line)" }),
    draw("text", { x: LEFT - 4, y: Math.max(y(value) + 4, 11), "text-anchor": "end", "font-size": 11, fill: "var(--quiet)" }, number(value, 1)),
  ]);
  const drawn = values.map((value, i) => {
    const colour = `var(--station-${(balls[i].station - 1) % 8})`;
    return draw("rect", { x: LEFT + i * step + 0.5, y: y(value), width: step - 1, height: HEIGHT - BELOW - y(value), fill: colour });
  });
  return [...lines, ...drawn];
}
