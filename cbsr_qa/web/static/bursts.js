import { keepName } from "./operators.js";

// A scanner that types into a field for people scans all the same: its keys come in one burst that ends with Enter, and
// the field is put back to what it was before. In the field of the serial number it replaces what was there.
const TYPED = "form[data-send] input:not([type=hidden], [type=password], #answer)";
const BURST_GAP_MS = 100;
let burst = null;
let lastKey = -BURST_GAP_MS;

export function followBurst({ target, key, timeStamp }) {
  if (key === "Shift") return;
  const paused = timeStamp - lastKey > BURST_GAP_MS;
  lastKey = timeStamp;
  if (key.length !== 1 || !target.matches?.(TYPED)) burst = null;
  else {
    if (burst?.field !== target || timeStamp - burst.last > BURST_GAP_MS) {
      burst = { field: target, before: target.value, since: timeStamp, keys: "", whole: paused };
    }
    burst.keys += key;
    burst.last = timeStamp;
  }
}

// Return what a scanner typed into a field before this Enter; empty if a person did.
export function takeBurst({ target, timeStamp }) {
  const { field, before, since, keys, whole } = burst ?? {};
  if (field !== target || keys.length < 3 || timeStamp - since > 50 * keys.length) return "";
  // Only what was there before the scan is replaced, not the scan's own beginning, which may have been typed elsewhere.
  if (field.id === "serial" && !(whole && field.value === before + keys)) return "";
  burst = null;
  field.value = before;
  if (field.id === "operator") keepName(field.form, before);
  return keys;
}
