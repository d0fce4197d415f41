// Who works at a station, as it was stated last at this browser, with the latest run of the station then: once another
// run has begun, its operator counts.
const nameKey = (form) => `cbsr-qa operator at ${new URL(form.action).pathname.split("/")[2]}`;
export const readName = (form) => JSON.parse(localStorage.getItem(nameKey(form)) ?? '["", ""]');
export function keepName(form, name) {
  const run = document.getElementById("operator")?.dataset.run ?? form.elements.run?.value ?? "";
  localStorage.setItem(nameKey(form), JSON.stringify([run, name]));
}
export function showName(place) {
  const field = place.querySelector("#operator");
  if (!field || !localStorage.getItem(nameKey(field.form))) return;
  const [run, name] = readName(field.form);
  if (run === field.dataset.run) field.value = name;
  else if (name === field.value) keepName(field.form, name);
  else localStorage.removeItem(nameKey(field.form));
}
// A name that was typed is kept even if the page is left in the middle of it.
addEventListener("pagehide", () => {
  const field = document.getElementById("operator");
  if (field?.matches(":focus")) keepName(field.form, field.value);
});
addEventListener("storage", () => { if (document.activeElement?.id !== "operator") showName(document); });
