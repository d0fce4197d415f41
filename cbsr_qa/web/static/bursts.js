import { keepName } from "./operators.js";

// A scanner that types into a field for people scans all the same: its keys come in one burst that ends with Enter, and
// the field is put back to what it was before.
const TYPED = "form[data-send] input:not([type=hidden], [type=password], #serial, #answer)";
const BURST_GAP_MS = 100;
let burst = null;

export function followBurst({ target, key, timeStamp }) {
  if (key === "Shift") return;
  if (key.length !== 1 || !target.matches?.(TYPED)) burst = null;
  else {
    if (burst?.field !== target || timeStamp - burst.last > BURST_GAP_MS) {
      burst = { field: target, before: target.value, since: timeStamp, keys: "" };
    }
    burst.keys += key;
    burst.last = timeStamp;
  }
}

// Return what a scanner typed into a field before this Enter; empty if a person did.
export function takeBurst({ target, timeStamp }) {
  const { field, before, since, keys } = burst ?? {};
  if (field !== target || keys.length < 3 || timeStamp - since > 50 * keys.length) return "";
  burst = null;
  field.value = before;
  if (field.id === "operator") keepName(field.form, before);
  return keys;
}
