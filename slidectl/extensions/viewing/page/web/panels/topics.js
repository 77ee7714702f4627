// All topics; of the chosen ones the rate, and the message as a tree of fields with units, or as a picture.

import { isNumber, isTime, nameOfElement, prepareUnits, typesOf, unitOf } from "../fields.js";
import { isPicture, Picture, showPicture } from "../pictures.js";
import { baseName, Button, html, inParts, number, store, useEffect, useRef, useState, useStore } from "../parts.js";
import { addToPlot } from "./plots.js";

const SHOW_MS = 200;
const MOST_ELEMENTS = 32;
const LONGEST_TEXT = 300;
const WINDOW_S = 5;
const opened = new Set();

/** The rate of a topic over the last seconds of simulated time. */
class Rate {
  constructor() {
    this.seen = [];
  }

  take(time, count) {
    if (this.seen.length && time < this.seen[this.seen.length - 1][0]) this.seen = [];
    this.seen.push([time, count]);
    while (this.seen.length > 2 && this.seen[0][0] < time - WINDOW_S) this.seen.shift();
  }

  get text() {
    if (this.seen.length < 2) return "";
    const [first, last] = [this.seen[0], this.seen[this.seen.length - 1]];
    return last[0] > first[0] ? `${((last[1] - first[1]) / (last[0] - first[0])).toFixed(1)} Hz` : "";
  }
}

function Leaf({ name, value, unit, onPlot }) {
  const isText = typeof value === "string";
  const text = isText ? (value.length > LONGEST_TEXT ? `${value.slice(0, LONGEST_TEXT)} …` : value) : typeof value === "boolean" ? String(value) : number(value, 4, true);
  return html`<div class="leaf"><span class="name" title=${name}>${name}</span><span class=${isText ? "text" : "value"}>${text}</span>
    <span class="unit">${unit}</span>${onPlot ? html`<${Button} icon="plot" title=${`Plot ${name}`} onClick=${onPlot} />` : html`<span />`}</div>`;
}

function Tree({ topic, root, types, kind, value, path, message }) {
  return html`<div class="branch">${(types[kind] ?? []).map((field) => {
    const inner = value?.[field.name];
    const here = path ? `${path}/${field.name}` : field.name;
    const plot = (at) => () => addToPlot(`${topic}/${at}`);
    const one = (element, at, label) => {
      if (isNumber(field.type)) {
        const shown = isTime(field.type) ? element.secs + element.nsecs / 1e9 : element;
        const about = nameOfElement(message, at);
        return html`<${Leaf} key=${at} name=${about ? `${label} ${about}` : label} value=${shown}
          unit=${unitOf(topic, types, root, at, about)} onPlot=${plot(at)} />`;
      }
      if (field.type === "string") return html`<${Leaf} key=${at} name=${label} value=${element} unit="" />`;
      return html`<${Branch} key=${at} label=${label} at=${`${topic}/${at}`}>${() => html`<${Tree} topic=${topic} root=${root} types=${types}
        kind=${field.type} value=${element} path=${at} message=${message} />`}<//>`;
    };
    if (inner === undefined) return null;
    if (field.array < 0) return one(inner, here, field.name);
    if (typeof inner === "string") return html`<${Leaf} key=${here} name=${field.name} value=${`${Math.floor((inner.length * 3) / 4)} bytes`} unit="" />`;
    if (!inner.length) return html`<${Leaf} key=${here} name=${field.name} value="empty" unit="" />`;
    return html`<${Branch} key=${here} label=${`${field.name} (${inner.length})`} at=${`${topic}/${here}`} isOpen=${inner.length <= 8}>${() => html`
      ${inner.slice(0, MOST_ELEMENTS).map((element, place) => one(element, `${here}[${place}]`, `[${place}]`))}
      ${inner.length > MOST_ELEMENTS && html`<p class="hint">and ${inner.length - MOST_ELEMENTS} more</p>`}`}<//>`;
  })}</div>`;
}

/** A part of a message that is folded in and out; its content is made only while it is open. */
function Branch({ label, at, isOpen = true, children }) {
  const [open, setOpen] = useState(isOpen && !at.endsWith("/header"));
  return html`<div><button type="button" class="fold" aria-expanded=${open} onClick=${() => setOpen(!open)}>${label}</button>${open && children()}</div>`;
}

function Message({ topic, type }) {
  const [types, setTypes] = useState(null);
  const [shown, setShown] = useState({ message: null, rate: "" });
  useEffect(() => {
    let ended = false;
    typesOf(type).then(async (found) => {
      await prepareUnits(topic);
      if (!ended) setTypes(found);
    }).catch(() => {});
    const rate = new Rate();
    let [newest, isNew, count] = [null, false, 0];
    const takes = (message, { time }) => {
      count += 1;
      newest = message;
      isNew = true;
      rate.take(time.secs + time.nsecs / 1e9, message.header?.seq ?? count);
    };
    let end = () => {};
    typesOf(type).then((found) => {
      if (ended) return;
      const isCounted = found[type]?.some((field) => field.name === "header");
      end = store.values.ros.subscribe(topic, takes, { throttle: isCounted ? SHOW_MS : 10, queue: isCounted ? 1 : 100 });
    }).catch(() => {});
    const timer = setInterval(() => {
      if (!isNew || document.hidden) return;
      isNew = false;
      setShown({ message: newest, rate: rate.text });
    }, SHOW_MS);
    return () => {
      ended = true;
      clearInterval(timer);
      end();
    };
  }, [topic, type]);
  if (!types) return null;
  return html`<div class="message"><p class="hint">${inParts(type)}${shown.rate && html` · <b>${shown.rate}</b>`}</p>
    ${shown.message ? html`<${Tree} topic=${topic} root=${type} types=${types} kind=${type} value=${shown.message} path="" message=${shown.message} />`
      : html`<p class="empty">No message has come yet.</p>`}</div>`;
}

function Topic({ one }) {
  const [open, setOpen] = useState(opened.has(one.name));
  const pictures = useStore((s) => s.pictures);
  const turn = () => {
    if (open) opened.delete(one.name);
    else opened.add(one.name);
    setOpen(!open);
  };
  const isShown = pictures.includes(one.name);
  const about = `${one.type}\npublishers: ${one.publishers.join(", ") || "none"}\nsubscribers: ${one.subscribers.join(", ") || "none"}`;
  return html`<div class="topic">
    <div class="row"><button type="button" class="fold name whole" aria-expanded=${open} title=${`${one.name}\n${about}`} onClick=${turn}>${inParts(one.name)}</button>
      <span class="value" title="Publishers and subscribers">${one.publishers.length} → ${one.subscribers.length}</span>
      ${isPicture(one.type) && html`<${Button} icon="camera" title=${`Show ${one.name} over the view`} aria-pressed=${isShown}
        onClick=${() => showPicture(one.name, !isShown)} />`}</div>
    ${open && (isPicture(one.type) ? html`<div class="message"><${Picture} topic=${one.name} type=${one.type} /></div>`
      : html`<${Message} topic=${one.name} type=${one.type} />`)}
  </div>`;
}

let text = "";

function Panel() {
  const topics = useStore((s) => s.topics);
  const [, again] = useState(0);
  const wanted = text.toLowerCase();
  const found = Object.values(topics).filter((one) => `${one.name} ${one.type}`.toLowerCase().includes(wanted));
  return html`<div class="line"><input aria-label="Topic contains" placeholder="Topic contains" value=${text}
      onInput=${(event) => { text = event.target.value; again((count) => count + 1); }} /></div>
    <div class="topics">${found.map((one) => html`<${Topic} key=${one.name} one=${one} />`)}
      ${!found.length && html`<p class="empty">No topic contains this.</p>`}</div>`;
}

export const topicsPanel = { title: "Topics", Panel };
