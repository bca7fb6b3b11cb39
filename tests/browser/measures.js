/* What can be measured of a view. Each function lists what is wrong, as text. */
const LEAST_PX = 48, LEAST_CONTRAST = 4.5, LEAST_CONTRAST_LARGE = 3;

window.shown = (element) => element.checkVisibility({ visibilityProperty: true, opacityProperty: true }) && element.getClientRects().length > 0;
window.nameOf = (element) => `${element.tagName} ${element.id || element.className.baseVal || element.className} "${(element.textContent ?? "").trim().slice(0, 30)}"`;

/* The part of the element that its scrolling ancestors leave to be seen. */
window.visibleBox = (element) => {
  let { left, top, right, bottom } = element.getBoundingClientRect();
  for (let p = element.parentElement; p; p = p.parentElement) {
    if (!/(auto|scroll|hidden)/.test(getComputedStyle(p).overflow)) continue;
    const box = p.getBoundingClientRect();
    [left, top, right, bottom] = [Math.max(left, box.left), Math.max(top, box.top), Math.min(right, box.right), Math.min(bottom, box.bottom)];
  }
  return right - left > 1 && bottom - top > 1 ? { left, top, right, bottom } : null;
};

/* The element must be whole on the screen, large enough for a finger, and covered by nothing. */
window.outOfView = (element) => {
  const { left, top, right, bottom, width, height } = element.getBoundingClientRect(), wrong = [];
  if (left < -0.5 || top < -0.5 || right > innerWidth + 0.5 || bottom > innerHeight + 0.5) wrong.push(`outside: ${nameOf(element)} ${left} ${top} ${right} ${bottom}`);
  if (width < LEAST_PX || height < LEAST_PX) wrong.push(`small: ${nameOf(element)} ${width} × ${height}`);
  const corners = [left + 12, (left + right) / 2, right - 12].flatMap((x) => [top + 12, (top + bottom) / 2, bottom - 12].map((y) => [x, y]));
  const covering = corners.map(([x, y]) => document.elementFromPoint(x, y)).filter((there) => !element.contains(there));
  return wrong.concat(covering.map((there) => `covered by ${there ? nameOf(there) : "nothing"}`));
};

window.misplaced = (root = document) => {
  const wrong = [], boxes = [];
  const page = document.documentElement;
  if (page.scrollWidth > innerWidth || page.scrollHeight > innerHeight) wrong.push(`the page scrolls: ${page.scrollWidth} × ${page.scrollHeight}`);
  for (const element of root.querySelectorAll("button, a, select, input:not([type=checkbox], [type=radio]), label.check")) {
    if (!shown(element)) continue;
    const { width, height } = element.getBoundingClientRect(), box = visibleBox(element);
    if (width < LEAST_PX || height < LEAST_PX) wrong.push(`small: ${nameOf(element)} ${width} × ${height}`);
    if (element.scrollWidth > element.clientWidth + 1 && element.tagName === "BUTTON") wrong.push(`cut: ${nameOf(element)}`);
    if (!box) continue;
    if (box.left < 0 || box.top < 0 || box.right > innerWidth + 0.5 || box.bottom > innerHeight + 0.5) wrong.push(`outside: ${nameOf(element)}`);
    for (const [other, there] of boxes) {
      const apart = box.left >= there.right - 1 || there.left >= box.right - 1 || box.top >= there.bottom - 1 || there.top >= box.bottom - 1;
      if (!apart && !other.contains(element) && !element.contains(other)) wrong.push(`overlap: ${nameOf(element)} and ${nameOf(other)}`);
    }
    boxes.push([element, box]);
  }
  for (const element of root.querySelectorAll("main, .side, .content, .sections, .top, .controls, dialog")) {
    if (shown(element) && element.scrollWidth > element.clientWidth + 1) wrong.push(`wider than its room: ${nameOf(element)}`);
  }
  return wrong;
};

window.rgba = (text) => {
  const context = document.createElement("canvas").getContext("2d", { willReadFrequently: true });
  context.fillStyle = text;
  context.fillRect(0, 0, 1, 1);
  const [r, g, b, a] = context.getImageData(0, 0, 1, 1).data;
  return [r, g, b, a / 255];
};

window.luminance = ([r, g, b]) => {
  const linear = [r, g, b].map((value) => value / 255).map((value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4));
  return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2];
};

window.backgroundOf = (element) => {
  for (let e = element; e; e = e.parentElement) {
    const colour = rgba(getComputedStyle(e).backgroundColor);
    if (colour[3] > 0.8) return colour;
  }
  return [255, 255, 255, 1];
};

window.unreadable = () => {
  const wrong = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (!walker.currentNode.textContent.trim() || !shown(element) || element.closest(":disabled, option, script")) continue;
    const style = getComputedStyle(element), colour = rgba(element.closest("svg") ? style.fill : style.color);
    const [high, low] = [luminance(colour), luminance(backgroundOf(element))].sort((a, b) => b - a);
    const size = parseFloat(style.fontSize), large = size >= 24 || (size >= 18.6 && Number(style.fontWeight) >= 600);
    const ratio = (high + 0.05) / (low + 0.05);
    if (ratio < (large ? LEAST_CONTRAST_LARGE : LEAST_CONTRAST)) wrong.push(`${nameOf(element)} ${ratio.toFixed(2)}`);
  }
  return wrong;
};

/* Texts, names and hints without the marks of the catalogue, as far as they hold words. */
window.unmarked = () => {
  const texts = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const element = walker.currentNode.parentElement;
    if (shown(element) && !element.closest("script, code")) texts.push(walker.currentNode.textContent);
  }
  for (const element of document.querySelectorAll("[aria-label], [title], [placeholder]")) {
    if (shown(element)) texts.push(...["aria-label", "title", "placeholder"].map((name) => element.getAttribute(name) ?? ""));
  }
  return texts.flatMap((text) => text.replaceAll(/⟦[^⟦⟧]*⟧/g, " ").match(/\p{L}{2,}/gu) ?? []);
};
