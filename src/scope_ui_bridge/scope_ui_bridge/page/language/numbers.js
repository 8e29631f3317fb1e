// The decimal sign of the page's language, for all shown numbers.

// A separate number, not part of a name, an address, a version or a position as typed (0.1,0.2@panel_link).
const DECIMAL = /(^|[\s(±≥≤])([+\-−]?\d+)\.(\d+)(?=$|[\s;,:)%°…]|\.(?:\s|$))/g;
const PAIR = /(\d,\d+), (?=[+\-−]?\d+,\d)/g;

function decimalSign() {
  const { lang } = document.documentElement;
  return new Intl.NumberFormat(lang).formatToParts(1.5).find(({ type }) => type === "decimal").value;
}

/** Return a number, or a text with numbers, with the decimal sign of the page's language. */
export function localNumbers(text) {
  const sign = decimalSign();
  if (sign === ".") return String(text);
  return String(text).replace(DECIMAL, `$1$2${sign}$3`).replace(PAIR, "$1; ");
}
