// What all panels are made of: Preact with htm, the store, and small elements. Text is always set as text.

import { h, render } from "preact";
import { useEffect, useRef, useState } from "preact/hooks";
import htm from "./vendor/htm.module.js";

export const html = htm.bind(h);
export { h, render, useEffect, useRef, useState };

// --- the store -------------------------------------------------------------------------------------------------------

/** Values that several parts show; who uses one is drawn again when it is set to another. */
class Store {
  constructor(values) {
    this.values = values;
    this.listeners = new Set();
  }

  set(changes) {
    let changed = false;
    for (const [key, value] of Object.entries(changes)) {
      changed ||= this.values[key] !== value;
      this.values[key] = value;
    }
    if (changed) for (const listener of [...this.listeners]) listener();
  }
}

export const store = new Store({});

/** States of a controller that runs: that of ros_control, and that of ros2_control. */
export const RUNNING = ["running", "active"];

/** The value that `select` takes from the store. */
export function useStore(select) {
  const [, again] = useState(0);
  const seen = useRef();
  seen.current = select(store.values);
  useEffect(() => {
    const listener = () => select(store.values) !== seen.current && again((count) => count + 1);
    store.listeners.add(listener);
    listener();
    return () => store.listeners.delete(listener);
  }, [select]);
  return seen.current;
}

/** Call `take` for each message of a topic as long as the element is there. */
export function useTopic(topic, take, options = {}) {
  const newest = useRef();
  newest.current = take;
  useEffect(() => {
    if (!topic) return undefined;
    return store.values.ros.subscribe(topic, (...given) => newest.current(...given), options);
  }, [topic]);
}

/** The newest message of a topic, drawn at most at the rate of `throttle` ms. */
export function useMessage(topic, options = { throttle: 200 }) {
  const [message, setMessage] = useState(null);
  useTopic(topic, (msg) => setMessage(msg), options);
  return message;
}

/** Call an action each `period` ms while the page is visible, and once at the beginning. */
export function useEvery(period, action, key = "") {
  const newest = useRef();
  newest.current = action;
  useEffect(() => {
    const act = () => document.hidden || newest.current();
    act();
    const timer = setInterval(act, period);
    return () => clearInterval(timer);
  }, [period, key]);
}

// --- the world -------------------------------------------------------------------------------------------------------

export const call = (service, args) => store.values.ros.call(service, args);
export const ask = (service, args) => store.values.ros.ask(service, args);
export const page = (what, args) => store.values.ros.call(`/slidectl_page/${what}`, args);

let notes = 0;

/** Show a notice for a while. `kind` is "", "good", "warning" or "bad". */
export function notify(text, hint = "", kind = "") {
  const shown = store.values.notices;
  const last = shown[shown.length - 1];
  if (last && last.text === text && last.hint === hint) return;
  const notice = { id: ++notes, text, hint, kind };
  store.set({ notices: [...shown.slice(-3), notice] });
  setTimeout(() => dismiss(notice.id), kind === "bad" ? 12_000 : 6000);
}

export const dismiss = (id) => store.set({ notices: store.values.notices.filter((one) => one.id !== id) });

/** Do an action; what is refused is shown with its reason. Returns whether it was done. */
export async function attempt(action) {
  try {
    await action();
    return true;
  } catch (error) {
    if (!error.hint && error.name !== "Error") console.error(error);
    notify(error.message, error.hint ?? "", "bad");
    return false;
  }
}

/** What is wrong, in one text: the message of an error and its hint. */
export const reasonOf = ({ message, hint }) => [message, hint].filter(Boolean).join(/[.!?:]$/.test(message) ? " " : ". ");

/** As `attempt`; then the world is read again. */
export async function act(action) {
  const done = await attempt(action);
  await store.values.readWorld?.();
  return done;
}

/** A name that may go on in the next line after each of its parts. */
export const inParts = (name) => name.split(/(?<=[_/])/).map((part) => html`${part}<wbr />`);

export const join = (space, name) => (name.startsWith("/") ? name : `${space === "/" ? "" : space}/${name}`);
export const baseName = (name) => name.slice(name.lastIndexOf("/") + 1);
export const isUnder = (name, space) => space === "/" || name === space || name.startsWith(`${space}/`);

// --- numbers ---------------------------------------------------------------------------------------------------------

/** A number as it is shown, with a fixed number of digits; a dash where it is not known. Small ones may be `exact`. */
export function number(value, digits = 3, exact = false) {
  if (value === null || value === undefined || Number.isNaN(value)) return "–";
  if (!Number.isFinite(value)) return value > 0 ? "∞" : "−∞";
  const size = Math.abs(value);
  if (size >= 1e6 || (exact && size && size < 10 ** -digits)) return value.toExponential(2).replace("-", "−");
  const text = value.toFixed(digits);
  return Number(text) === 0 ? (0).toFixed(digits) : text.replace("-", "−");
}

const LENGTHS = { position: "m", velocity: "m/s", acceleration: "m/s²", effort: "N" };
const ANGLES = { position: "rad", velocity: "rad/s", acceleration: "rad/s²", effort: "N·m" };

export function jointUnit(joint, quantity) {
  return (joint?.type === "prismatic" ? LENGTHS : ANGLES)[quantity] ?? "";
}

// --- elements --------------------------------------------------------------------------------------------------------

/** A button. `icon` is a name of ICONS; with one and without children it is a square, and `title` its name. */
export function Button({ icon, kind = "", title, children, ...rest }) {
  const alone = icon && !children;
  return html`<button type="button" class="button ${kind} ${alone ? "square" : ""}" title=${title} aria-label=${
    alone ? title : undefined
  } ...${rest}>${icon && html`<${Icon} name=${icon} />`}${children}</button>`;
}

/** A button for what changes the world: off on a read-only page. */
export function Act({ onClick, disabled, ...rest }) {
  const readOnly = useStore((s) => s.readOnly);
  return html`<${Button} ...${rest} disabled=${disabled || readOnly} onClick=${() => act(onClick)} />`;
}

export function Chip({ state }) {
  const kind = { running: "good", active: "good", waiting: "warning", stopped: "", initialized: "", aborted: "bad", unloaded: "faint" };
  return html`<span class="chip ${kind[state] ?? ""}">${state}</span>`;
}

export function Group({ title, children, aside }) {
  return html`<section class="group">
    ${title && html`<header><h2>${title}</h2>${aside}</header>`}${children}
  </section>`;
}

export function Field({ label, children, hint, error }) {
  return html`<label class="field"><span title=${hint}>${label}</span>${children}
    ${error && html`<em class="error">${error}</em>`}</label>`;
}

export function Empty({ children }) {
  return html`<p class="empty">${children}</p>`;
}

/** What an element shows, and what it calls with a choice: it shows the choice until that holds or was refused, since
 * the panel may be drawn again before the answer comes. `onChange` may be asynchronous; its end is the answer. */
function useChoice(value, onChange) {
  const [choice, setChoice] = useState(null);
  const newest = useRef(0);
  const choose = async (wanted) => {
    newest.current += 1;
    const mine = newest.current;
    setChoice({ wanted });
    try {
      await onChange(wanted);
    } finally {
      if (mine === newest.current) setChoice(null);
    }
  };
  return [choice ? choice.wanted : value, choose];
}

export function Select({ value, options, onChange, label, ...rest }) {
  const [shown, choose] = useChoice(value, onChange);
  return html`<select aria-label=${label} value=${shown} onChange=${(event) => choose(event.target.value)} ...${rest}>
    ${options.map((one) => {
      const [key, text] = Array.isArray(one) ? one : [one, one];
      return html`<option value=${key} selected=${key === shown}>${text}</option>`;
    })}
  </select>`;
}

/** A check box with its label behind it. */
export function Check({ checked, onChange, children, disabled }) {
  const [shown, choose] = useChoice(checked, onChange);
  return html`<label class="check"><input type="checkbox" checked=${shown} disabled=${disabled}
    onChange=${(event) => choose(event.target.checked)} /><span>${children}</span></label>`;
}

/** A text that is taken with Enter or when the field is left; Escape gives it up. Until then nothing overwrites it. */
export function Typed({ value, onCommit, ...rest }) {
  const [draft, setDraft] = useState(null);
  const commit = () => {
    if (draft === null) return;
    setDraft(null);
    onCommit(draft.trim());
  };
  const onKey = (event) => {
    if (event.key === "Enter") commit();
    else if (event.key === "Escape") setDraft(null);
  };
  return html`<input type="text" ...${rest} value=${draft ?? value} onInput=${(event) => setDraft(event.target.value)}
    onKeyDown=${onKey} onBlur=${commit} />`;
}

/** Let the browser save a text or bytes as a file. */
export function download(name, content, type = "text/plain") {
  const address = URL.createObjectURL(new Blob([content], { type }));
  const link = Object.assign(document.createElement("a"), { href: address, download: name });
  link.click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

const ICONS = {
  play: "M7 4.5v15l12-7.5z",
  pause: "M7 4.5h3.4v15H7zM13.6 4.5H17v15h-3.4z",
  step: "M5 5v14l9-7zM16 5h3v14h-3z",
  reset: "M12 5a7 7 0 1 1-6.6 4.7l1.9.7A5 5 0 1 0 12 7v3L7 6l5-4z",
  record: "M12 5a7 7 0 1 1 0 14 7 7 0 0 1 0-14z",
  stop: "M6 6h12v12H6z",
  camera: "M4 7h4l1.5-2h5L16 7h4v12H4zm8 2.5a3.5 3.5 0 1 0 0 7 3.5 3.5 0 0 0 0-7z",
  sun: "M12 8a4 4 0 1 1 0 8 4 4 0 0 1 0-8zM11 2h2v3h-2zM11 19h2v3h-2zM2 11h3v2H2zM19 11h3v2h-3zM4.2 5.6l1.4-1.4 2.1 2.1-1.4 1.4zM16.3 17.7l1.4-1.4 2.1 2.1-1.4 1.4zM4.2 18.4l2.1-2.1 1.4 1.4-2.1 2.1zM16.3 6.3l2.1-2.1 1.4 1.4-2.1 2.1z",
  moon: "M20 14.5A8.5 8.5 0 0 1 9.5 4 8.5 8.5 0 1 0 20 14.5z",
  left: "M4 5h16v14H4zm2 2v10h3V7z",
  right: "M4 5h16v14H4zm11 2v10h3V7z",
  keys: "M3 6h18v12H3zm2 2v2h2V8zm4 0v2h2V8zm4 0v2h2V8zm4 0v2h2V8zM7 13v2h10v-2z",
  close: "M6.4 5 12 10.6 17.6 5 19 6.4 13.4 12l5.6 5.6-1.4 1.4-5.6-5.6L6.4 19 5 17.6 10.6 12 5 6.4z",
  more: "M6 10.2a1.8 1.8 0 1 1 0 3.6 1.8 1.8 0 0 1 0-3.6zm6 0a1.8 1.8 0 1 1 0 3.6 1.8 1.8 0 0 1 0-3.6zm6 0a1.8 1.8 0 1 1 0 3.6 1.8 1.8 0 0 1 0-3.6z",
  gains: "M5 4h2v7H5zM5 15h2v5H5zM3 11h6v2.5H3zM11 4h2v3h-2zM11 11h2v9h-2zM9 7.5h6V10H9zM17 4h2v9h-2zM17 17h2v3h-2zM15 13.5h6V16h-6z",
  plot: "M4 4h2v14h14v2H4zm4 11 4-6 3 3 4-7 1.7 1-5.4 9.4-3-3L9.7 16z",
  up: "M12 6l7 8H5z",
  down: "M12 18l-7-8h14z",
  back: "M6 12l8-7v14z",
  forth: "M18 12l-8 7V5z",
};

export function Icon({ name }) {
  return html`<svg class="icon" viewBox="0 0 24 24" aria-hidden="true"><path d=${ICONS[name]} /></svg>`;
}
