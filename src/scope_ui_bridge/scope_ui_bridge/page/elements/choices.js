// Lists of choices. A browser that draws the open list itself uses Esc to close it, and the page receives only the
// key's release. In such browsers the page opens a list of its own instead, so that Esc stops at once.

const OPEN_LIST = "select:open";
const ROWS = 8;
let own = null; // the page's own list while it is open, {of, list, close}

/** The open list of choices, if the browser reports it. */
export function openList() {
  if (own) return own.list;
  return CSS.supports(`selector(${OPEN_LIST})`) ? document.querySelector(OPEN_LIST) : null;
}

/** Arrow keys choose in a closed list, as in the browser's lists; a list drawn by the page would open. */
export function wireChoices() {
  document.addEventListener("keydown", (event) => {
    const step = { ArrowDown: 1, ArrowUp: -1 }[event.key];
    const list = event.target;
    if (!step || !list.matches?.("select") || event.altKey || event.shiftKey || openList()) return;
    event.preventDefault();
    let index = list.selectedIndex + step;
    while (list.options[index]?.disabled) index += step;
    if (list.options[index]) choose(list, list.options[index].value);
  });
  if (CSS.supports("appearance", "base-select")) return;
  let pointer = ""; // touch devices have no Esc key, and telephones have lists made for fingers
  document.addEventListener("pointerdown", (event) => (pointer = event.pointerType), true);
  document.addEventListener("mousedown", (event) => {
    if (event.button === 0 && pointer === "mouse") instead(event);
  });
  document.addEventListener("keydown", (event) => {
    const opens = event.altKey ? ["ArrowDown", "ArrowUp"] : [" ", "Enter", "F4"];
    if (opens.includes(event.key)) instead(event);
  });
}

function choose(select, value) {
  select.value = value;
  for (const kind of ["input", "change"]) select.dispatchEvent(new Event(kind, { bubbles: true }));
}

function instead(event) {
  const select = event.target.closest?.("select");
  if (!select || select.disabled || select === own?.list) return;
  event.preventDefault();
  const again = own?.of === select;
  own?.close();
  if (!again) open(select);
}

function open(select) {
  const list = document.createElement("select");
  list.className = "choices";
  list.size = Math.min(Math.max(select.options.length, 2), ROWS);
  list.append(...[...select.options].map((option) => option.cloneNode(true)));
  list.value = select.value;
  list.setAttribute("aria-label", select.labels[0]?.innerText.trim() ?? "");
  const ended = new AbortController();
  const close = () => {
    ended.abort();
    own = null;
    if (document.activeElement === list) select.focus({ preventScroll: true });
    list.remove();
  };
  const take = () => {
    close();
    if (list.selectedOptions.length) choose(select, list.value);
  };
  const until = { signal: ended.signal };
  list.addEventListener("click", ({ target }) => target.matches("option") && take(), until);
  list.addEventListener("blur", close, until);
  list.addEventListener("keydown", (event) => {
    event.stopPropagation(); // it would open the next list
    if (["Enter", " "].includes(event.key)) event.preventDefault(), take();
    if (["Escape", "Tab"].includes(event.key)) close();
  }, until);
  document.body.append(list);
  const [at, { height }] = [select.getBoundingClientRect(), list.getBoundingClientRect()];
  const left = () => select.getBoundingClientRect().top !== at.top && close();
  for (const kind of ["scroll", "resize"]) addEventListener(kind, left, { ...until, capture: true });
  const below = at.bottom + height <= innerHeight;
  Object.assign(list.style, {
    left: `${at.left}px`, minWidth: `${at.width}px`, top: `${below ? at.bottom : Math.max(0, at.top - height)}px`,
  });
  own = { of: select, list, close };
  list.focus({ preventScroll: true });
}
