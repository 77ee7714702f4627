// Gains that are changed while a controller runs (rqt_reconfigure). A typed value is set on Enter or when the field is left.

import { act, Act, call, Check, html, reasonOf, store, Typed, useEffect, useState, useStore } from "../parts.js";

const MOST_CHANGES = 100;

const valuesOf = (config) => Object.fromEntries([...config.doubles, ...config.bools].map((one) => [one.name, one.value]));

async function set(server, wanted) {
  const entries = Object.entries(wanted).map(([name, value]) => ({ name, value }));
  const config = {
    bools: entries.filter((one) => typeof one.value === "boolean"),
    doubles: entries.filter((one) => typeof one.value === "number"),
  };
  return valuesOf((await call(`${server}/set_parameters`, { config })).config);
}

const changes = new Map(); // server -> [{before, after}], as long as the page is open

export function Gains({ space, server }) {
  const readOnly = useStore((s) => s.readOnly);
  const [options, setOptions] = useState([]);
  const [values, setValues] = useState({});
  const [limits, setLimits] = useState({ min: {}, max: {} });
  const [errors, setErrors] = useState({});
  const done = changes.get(server) ?? [];
  useEffect(() => {
    const { ros } = store.values;
    const ends = [
      ros.subscribe(`${server}/parameter_descriptions`, (msg) => {
        setOptions(msg.groups[0].parameters);
        setLimits({ min: valuesOf(msg.min), max: valuesOf(msg.max) });
      }),
      ros.subscribe(`${server}/parameter_updates`, (msg) => setValues(valuesOf(msg))),
    ];
    return () => ends.forEach((end) => end());
  }, [server]);

  const turn = async (name, value) => {
    try {
      if (typeof value === "number" && !Number.isFinite(value)) throw new Error("this is not a number");
      const after = await set(server, { [name]: value });
      if (after[name] !== values[name]) {
        changes.set(server, [...done, { before: { [name]: values[name] }, after: { [name]: after[name] } }].slice(-MOST_CHANGES));
      }
      setValues(after);
      setErrors({ ...errors, [name]: "" });
    } catch (error) {
      setErrors({ ...errors, [name]: reasonOf(error) });
      setValues({ ...values });
    }
  };
  const undo = async () => {
    const last = done[done.length - 1];
    changes.set(server, done.slice(0, -1));
    setValues(await set(server, last.before));
  };
  const inner = server.slice(space === "/" ? 1 : space.length + 1).split("/").slice(1).join("/");
  return html`<div class="gains">
    ${inner && html`<h3>${inner}</h3>`}
    <div class="grid">${options.filter((one) => one.name in values).map((one) => {
      const value = values[one.name];
      const hint = `${one.description} ${one.name in limits.min && typeof value === "number"
        ? `(${limits.min[one.name]} to ${limits.max[one.name]})` : ""}`;
      return typeof value === "boolean"
        ? html`<${Check} key=${one.name} checked=${value} disabled=${readOnly} onChange=${(to) => turn(one.name, to)}>${one.name}<//>`
        : html`<label class="gain" key=${one.name} title=${hint}><span>${one.name}</span>
            <${Typed} inputmode="decimal" value=${String(value)} disabled=${readOnly} aria-invalid=${!!errors[one.name]}
              onCommit=${(text) => turn(one.name, text === "" ? NaN : Number(text.replace(",", ".")))} /></label>`;
    })}</div>
    ${Object.entries(errors).map(([name, text]) => text && html`<em class="error" key=${name}>${name}: ${text}</em>`)}
    ${done.length > 0 && html`<div class="line"><${Act} onClick=${undo}>Undo<//>
      <span class="hint">${done.slice(-3).reverse().map(({ before, after }) =>
        Object.keys(before).map((name) => `${name} ${before[name]} → ${after[name]}`)).join(", ")}</span></div>`}
  </div>`;
}
