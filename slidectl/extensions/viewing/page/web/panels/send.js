// Messages and requests by a form: publish on any topic, once or at a rate, and call any service.
// Texts become messages in `slidectl view`, as `slidectl pub` makes them: with expressions in i and t, times `now`, and YAML.

import { act, Act, ask, call, Empty, Field, Group, html, inParts, notify, page, Select, store, useEffect, useState, useStore } from "../parts.js";
import { parsed } from "../fields.js";

const kept = new Map(); // type -> {path: text or bool}, as long as the page is open
const FLOATS = ["float32", "float64"];
const PRIMITIVES = new Set([
  "bool", "byte", "char", "int8", "uint8", "int16", "uint16", "int32", "uint32", "int64", "uint64", "float32", "float64", "string",
  "time", "duration",
]);

/** The inputs of a message: [{path, type, array}]. Arrays and times are one input each. */
function inputsOf(types, root) {
  const found = [];
  const walk = (kind, path, depth) => {
    for (const field of types[kind] ?? []) {
      const here = path ? `${path}.${field.name}` : field.name;
      if (field.array >= 0 || PRIMITIVES.has(field.type) || depth > 20) found.push({ path: here, ...field });
      else walk(field.type, here, depth + 1);
    }
  };
  walk(root, "", 0);
  return found;
}

function initial(field) {
  if (field.array >= 0) return field.array === 0 ? "[]" : "";
  if (field.type === "bool") return false;
  if (["string", "time", "duration"].includes(field.type)) return "";
  return FLOATS.includes(field.type) ? "0.0" : "0";
}

function Form({ kind, types, texts, onChange }) {
  const readOnly = useStore((s) => s.readOnly);
  return html`<fieldset class="form" disabled=${readOnly}><legend>${inParts(kind)}</legend>${inputsOf(types, kind).map((field) => {
    const value = texts[field.path] ?? initial(field);
    const set = (to) => onChange({ ...texts, [field.path]: to });
    const about = `${field.type}${field.array < 0 ? "" : field.array ? `[${field.array}]` : "[]"}`;
    return typeof value === "boolean"
      ? html`<label class="check" key=${field.path}><input type="checkbox" checked=${value} onChange=${(event) => set(event.target.checked)} /><span>${field.path}</span></label>`
      : html`<${Field} key=${field.path} label=${field.path} hint=${about}><input value=${value} placeholder=${about} onInput=${(event) => set(event.target.value)} /><//>`;
  })}</fieldset>`;
}

/** The type and the fields of the form of a topic or a service. */
function useForm(kind, name) {
  const [form, setForm] = useState(null);
  const [, again] = useState(0);
  useEffect(() => {
    let ended = false;
    setForm(null);
    if (name) {
      call("/slidectl/resolve", { kind, name, namespace: "/", role: "", with_field: false }).then((answer) => {
        const types = parsed(answer.typedefs);
        const root = answer.typedefs[0]?.type ?? answer.type;
        if (!ended) setForm({ name, type: answer.type, root, types });
      }).catch(() => {});
    }
    return () => { ended = true; };
  }, [kind, name]);
  const texts = (form && kept.get(form.type)) ?? {};
  const all = form ? Object.fromEntries(inputsOf(form.types, form.root).map((field) => [field.path, texts[field.path] ?? initial(field)])) : {};
  const setTexts = (to) => {
    kept.set(form.type, to);
    again((count) => count + 1);
  };
  return { form, texts: all, setTexts };
}

function Publish() {
  const topics = useStore((s) => s.topics);
  const running = useStore((s) => s.pageState?.publications) ?? [];
  const [topic, setTopic] = useState("");
  const [rate, setRate] = useState("10");
  const { form, texts, setTexts } = useForm("topic", topic in topics ? topic : "");
  const warn = () => topics[topic]?.subscribers.length || notify(`Nobody subscribes to ${topic}`, "", "warning");
  const once = async () => {
    warn();
    const { message } = await page("fill", { topic, texts });
    const reasons = await store.values.ros.publish(topic, message);
    if (reasons?.length) notify(topic, reasons.join("\n"), "warning");
  };
  const begin = async () => {
    const hertz = Number(rate);
    if (!(hertz >= 0.01 && hertz <= 1000)) throw new Error("a rate is from 0.01 to 1000 Hz");
    warn();
    await page("publish", { topic, texts, rate: hertz });
  };
  return html`<${Group} title="Publish">
    <${Field} label="Topic"><${Select} label="Topic" value=${topic} options=${[["", "Choose a topic"], ...Object.keys(topics)]} onChange=${setTopic} /><//>
    ${form && html`<${Form} kind=${form.root} types=${form.types} texts=${texts} onChange=${setTexts} />
      <div class="line"><${Act} kind="primary" onClick=${once}>Publish once<//>
        <${Act} onClick=${begin}>Publish at<//>
        <input class="short" inputmode="decimal" aria-label="Rate, Hz of simulated time" value=${rate} onInput=${(event) => setRate(event.target.value)} /><span class="unit">Hz</span></div>
      <p class="hint">Numbers may be expressions in t (s) and i. i counts the messages, t is their time in s.</p>`}
    ${running.map((one) => html`<div class="row" key=${one.topic}><span class="name" title=${one.topic}>${one.topic}</span>
      <span class="value">${one.rate} Hz, ${one.published} published</span>
      <${Act} aria-label=${`Stop ${one.topic}`} onClick=${() => page("stop_publishing", { topic: one.topic })}>Stop<//></div>
      ${one.reason && html`<p class="hint">${one.reason}</p>`}`)}
  <//>`;
}

/** A value as YAML, for reading. */
function yaml(value, indent = "") {
  if (Array.isArray(value)) {
    if (!value.length) return " []";
    if (value.every((one) => one === null || typeof one !== "object")) return ` [${value.map((one) => (one === null ? "nan" : JSON.stringify(one))).join(", ")}]`;
    return value.map((one) => `\n${indent}-${yaml(one, `${indent}  `).replace(/^\n\s*/, " ")}`).join("");
  }
  if (value && typeof value === "object") return Object.entries(value).map(([name, one]) => `\n${indent}${name}:${yaml(one, `${indent}  `)}`).join("");
  if (typeof value === "string") return value.includes("\n") ? ` |\n${value.split("\n").map((line) => `${indent}${line}`).join("\n")}` : ` ${value || '""'}`;
  return ` ${value === null ? "nan" : value}`;
}

const LONGEST = 20_000;

function Services() {
  const services = useStore((s) => s.services);
  const [service, setService] = useState("");
  const [answer, setAnswer] = useState("");
  const { form, texts, setTexts } = useForm("service", service in services ? service : "");
  const begin = async () => {
    setAnswer("calling …");
    try {
      const { message } = await page("fill", { service, texts });
      const { values, reasons } = await ask(service, message);
      const text = [yaml(values).replace(/^\n/, "") || "an empty answer", ...reasons.map((one) => `# ${one}`)].join("\n");
      setAnswer(text.length > LONGEST ? `${text.slice(0, LONGEST)} …` : text);
    } catch (error) {
      setAnswer(`failed: ${[error.message, error.hint].filter(Boolean).join("\n")}`);
    }
  };
  return html`<${Group} title="Services">
    <${Field} label="Service"><${Select} label="Service" value=${service} options=${[["", "Choose a service"], ...Object.keys(services)]} onChange=${setService} /><//>
    ${form && html`<${Form} kind=${form.root} types=${form.types} texts=${texts} onChange=${setTexts} />
      <div class="line"><${Act} kind="primary" onClick=${begin}>Call<//></div>`}
    ${answer && html`<pre class="answer" tabindex="0" aria-label="Answer">${answer}</pre>`}
  <//>`;
}

const Panel = () => html`<${Publish} /><${Services} />`;

export const sendPanel = { title: "Send", Panel };
