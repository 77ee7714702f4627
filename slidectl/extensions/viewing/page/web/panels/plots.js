// Fields of topics over the last seconds of simulated time, several in one plot (rqt_plot). The plots go on while another
// panel is shown; their fields are in the address of the page.

import uPlot from "uplot";
import { expanded, nameOfElement, numbersIn, resolve, steps, unitOf, valueAt } from "../fields.js";
import { attempt, baseName, Button, download, Field, Group, html, inParts, join, notify, reasonOf, RUNNING, Select, store, useEffect, useRef, useState, useStore } from "../parts.js";

const COLOURS = ["#2f6fed", "#e8710a", "#1e9e5a", "#c5221f", "#8e44c9", "#8d6e63", "#d0459b", "#0f9fb5"];
const MOST_PLOTS = 8;
const MOST_FIELDS = 16;
const MOST_CURVES = 32;
const MOST_SAMPLES = 200_000;
const MOST_POINTS = 800;
const DRAW_MS = 100;
const LONGEST_S = 120;
const plots = []; // the live plots
let serial = 0;
let seconds = Number(localStorage.getItem("slidectl.window")) || 10;
const changed = () => store.set({ plots: [...plots] });

/** Samples of one number. */
class Curve {
  constructor(label, unit) {
    this.label = label;
    this.unit = unit;
    this.clear();
  }

  clear() {
    this.times = [];
    this.values = [];
  }

  add(time, value) {
    this.times.push(time);
    this.values.push(value);
    if (this.times.length > MOST_SAMPLES || this.times[0] < time - 2 * LONGEST_S) {
      const old = Math.max(1, this.times.findIndex((one) => one >= time - LONGEST_S));
      this.times.splice(0, old);
      this.values.splice(0, old);
    }
  }

  /** Times and values from `begin` on. */
  since(begin) {
    let [low, high] = [0, this.times.length];
    while (low < high) {
      const middle = (low + high) >> 1;
      if (this.times[middle] < begin) low = middle + 1;
      else high = middle;
    }
    return [this.times.slice(low), this.values.slice(low)];
  }
}

class LivePlot {
  constructor() {
    this.id = ++serial;
    this.fields = []; // texts
    this.troubles = {}; // text -> why it has no curve
    this.curves = [];
    this.ends = new Map(); // text -> ends its subscription
    this.derived = "values"; // or derivative, difference
    this.frozen = null; // the time at which it was paused
    this.end = -Infinity;
    this.count = 0;
  }

  /** Follow a field. Rejects with what is wrong with it. */
  async add(text) {
    if (this.ends.has(text)) return;
    if (!this.fields.includes(text) && this.fields.length >= MOST_FIELDS) {
      throw Object.assign(new Error(`a plot has at most ${MOST_FIELDS} fields`), { hint: "Take another plot." });
    }
    const found = await resolve(text);
    if (this.ends.has(text)) return;
    if (!this.fields.includes(text)) this.fields.push(text);
    delete this.troubles[text];
    this.ends.set(text, this.follow(text, found));
    changed();
  }

  follow(text, { topic, path, type, types }) {
    const taken = steps(path);
    const curves = new Map(); // path -> curve
    return store.values.ros.subscribe(topic, (message, { time }) => {
      if (this.frozen !== null) return;
      const now = time.secs + time.nsecs / 1e9;
      if (now < this.end - 1e-9) this.forget(); // a reset
      this.end = Math.max(this.end, now);
      this.count += 1;
      const value = valueAt(message, taken);
      if (value === undefined) {
        if (!curves.size) this.trouble(text, `${path} of ${topic} has no such element`);
        return;
      }
      for (const [one, sample] of numbersIn(value, path, MOST_CURVES)) {
        let curve = curves.get(one);
        if (!curve) {
          const about = nameOfElement(message, one);
          curve = new Curve(`${topic}/${one}${about ? ` (${about})` : ""}`, unitOf(topic, types, type, one, about));
          curves.set(one, curve);
          this.curves.push(curve);
          if (this.curves.length === 1) changed(); // the plot is not empty any more
        }
        curve.add(now, Number.isFinite(sample) && Math.abs(sample) < 1e300 ? sample : null);
      }
    }, { queue: 1000 });
  }

  trouble(text, why) {
    if (this.troubles[text] === why) return;
    this.troubles[text] = why;
    changed();
  }

  forget() {
    for (const curve of this.curves) curve.clear();
    this.end = -Infinity;
  }

  /** End the subscriptions: the daemon has gone, and the next one may not have the topics yet. */
  leave() {
    for (const end of this.ends.values()) end();
    this.ends.clear();
    this.curves = [];
    this.end = -Infinity;
  }

  /** Follow the fields whose topics have come. */
  async followAgain() {
    for (const text of this.fields) {
      if (!this.ends.has(text)) await this.add(text).catch((error) => this.trouble(text, reasonOf(error)));
    }
  }

  remove() {
    for (const end of this.ends.values()) end();
    plots.splice(plots.indexOf(this), 1);
    changed();
    writeAddress();
  }

  pause() {
    this.frozen = this.frozen === null ? this.end : null;
    changed();
  }

  /** What is drawn: [{label, unit, times, values}] of the last seconds. */
  shown() {
    const end = this.frozen ?? this.end;
    const labels = shortened(this.curves.map((one) => one.label));
    const found = this.curves.map((curve, place) => {
      const [times, values] = curve.since(end - seconds);
      return { label: labels[place], unit: curve.unit, times, values };
    });
    if (this.derived === "derivative") return found.map(derivative);
    if (this.derived === "difference" && found.length > 1) return found.slice(1).map((one) => difference(found[0], one));
    return found;
  }
}

function derivative({ label, unit, times, values }) {
  const slopes = times.map((time, place) => {
    if (!place || values[place] === null || values[place - 1] === null || time <= times[place - 1]) return null;
    return (values[place] - values[place - 1]) / (time - times[place - 1]);
  });
  return { label: `d/dt ${label}`, unit: unit ? (unit.endsWith("/s") ? `${unit}²` : `${unit}/s`) : "", times, values: slopes };
}

/** The second minus the first; the second is interpolated at the times of the first. */
function difference(first, second) {
  let place = 0;
  const values = first.times.map((time, at) => {
    while (place + 1 < second.times.length && second.times[place + 1] <= time) place += 1;
    const [t0, t1] = [second.times[place], second.times[place + 1]];
    const [v0, v1] = [second.values[place], second.values[place + 1]];
    if (first.values[at] === null || v0 === undefined || v0 === null || t0 > time) return null;
    const value = t1 === undefined || v1 === null || t0 === time ? (t0 === time ? v0 : null) : v0 + ((v1 - v0) * (time - t0)) / (t1 - t0);
    return value === null ? null : value - first.values[at];
  });
  return { label: `${second.label} − ${first.label}`, unit: first.unit === second.unit ? first.unit : "", times: first.times, values };
}

/** The shortest distinct ends of names. */
function shortened(labels) {
  const parts = labels.map((label) => label.split("/"));
  for (let count = 1; count <= Math.max(0, ...parts.map((one) => one.length)); count++) {
    const ends = parts.map((one) => one.slice(-count).join("/"));
    if (new Set(ends).size === ends.length) return ends;
  }
  return labels;
}

/** The lowest and the highest sample of each part, so that no peak is lost. */
function thinned(curve, most) {
  const { times, values } = curve;
  if (times.length <= most) return [times, values];
  const size = Math.ceil((2 * times.length) / most);
  const [t, v] = [[], []];
  for (let begin = 0; begin < times.length; begin += size) {
    const end = Math.min(times.length, begin + size);
    let [low, high] = [begin, begin];
    for (let place = begin; place < end; place++) {
      if (values[place] < values[low]) low = place;
      if (values[place] > values[high]) high = place;
    }
    for (const place of low === high ? [low] : [Math.min(low, high), Math.max(low, high)]) {
      t.push(times[place]);
      v.push(values[place]);
    }
  }
  return [t, v];
}

/** The range of an axis: that of the samples with some air; noise around a constant is not blown up. */
function padded(_, low, high) {
  if (low === null || high === null) return [-1, 1];
  const least = Math.max(1e-3, 1e-3 * Math.max(Math.abs(low), Math.abs(high)));
  const air = Math.max(0.08 * (high - low), (least - (high - low)) / 2);
  return [low - air, high + air];
}

function tables(curves) {
  const most = Math.max(100, Math.floor((2 * MOST_POINTS) / Math.max(1, curves.length)));
  const some = curves.map((one) => thinned(one, most)).filter(([times]) => times.length);
  return some.length ? uPlot.join(curves.map((one) => thinned(one, most)), curves.map(() => [2])) : [[], ...curves.map(() => [])];
}

// --- the address -----------------------------------------------------------------------------------------------------

function writeAddress() {
  const query = new URLSearchParams(location.search);
  query.delete("plot");
  for (const plot of plots) for (const text of plot.fields) query.append("plot", text);
  history.replaceState(null, "", `?${query}`);
}

let given = null;

/** The plot of the address: all of its fields in one. Without one, that of the first controller. */
export function plotFromAddress(texts) {
  given = [...new Set(texts)].slice(0, MOST_FIELDS);
  store.set({ plots: [] });
  if (given.length) {
    const plot = new LivePlot();
    plot.fields = given.flatMap(expanded);
    plots.push(plot);
    changed();
  }
  let topics = null;
  store.listeners.add(() => {
    if (store.values.isThere === false) {
      if (topics) for (const plot of plots) plot.leave();
      topics = null;
      return;
    }
    if (topics === store.values.topics) return;
    if (!store.values.status) return; // the controllers come with the status
    topics = store.values.topics;
    for (const plot of plots) plot.followAgain();
    if (isShown && !plots.length && !given.length && !isTouched) plotFirst();
  });
}

let isTouched = false;
let isShown = false; // the panel: what nobody looks at costs the daemon nothing

/** Plot set point and process value of the first controller that has them, else the first joint. */
async function plotFirst() {
  const { topics, controllers } = store.values;
  for (const [space, list] of Object.entries(controllers)) {
    for (const one of list.filter((each) => RUNNING.includes(each.state))) {
      const state = join(space, `${one.name}/state`);
      const fields = {
        "control_msgs/JointControllerState": ["set_point", "process_value"],
        "control_msgs/JointTrajectoryControllerState": ["desired/positions[0]", "actual/positions[0]"],
      }[topics[state]?.type];
      if (fields) return begin(fields.map((field) => `${state}/${field}`));
    }
  }
  const joints = Object.values(topics).find((one) => one.type === "sensor_msgs/JointState" && one.publishers.length);
  return joints && begin([`${joints.name}/position`]);
}

async function begin(fields) {
  if (plots.length || isTouched) return;
  isTouched = true;
  const plot = new LivePlot();
  plots.push(plot);
  for (const field of fields) await plot.add(field).catch((error) => plot.trouble(field, reasonOf(error)));
}

/** Add a field to a plot, which is that of the number `id`, the last one, or a new one. Rejects with what is wrong. */
async function add(text, id) {
  isTouched = true;
  let plot = id === "last" ? plots[plots.length - 1] : plots.find((one) => String(one.id) === id);
  const isNew = !plot;
  if (isNew && plots.length >= MOST_PLOTS) {
    throw Object.assign(new Error(`there are ${MOST_PLOTS} plots, and there can be no more`), { hint: "Remove one." });
  }
  plot ??= new LivePlot();
  for (const one of expanded(text)) {
    const { topic, path } = await resolve(one);
    await plot.add(path ? `${topic}/${path}` : topic); // the full name: the address is for others, too
  }
  if (isNew) plots.push(plot);
  changed();
  writeAddress();
}

export const addToPlot = (text) => attempt(async () => {
  await add(text, "last");
  store.set({ right: store.values.right });
  notify(`${text} is plotted`, "", "good");
});

// --- the panel -------------------------------------------------------------------------------------------------------

function Chart({ plot }) {
  const place = useRef();
  const dark = useStore((s) => s.dark);
  useEffect(() => {
    let chart = null;
    let drawn = "";
    let count = -1;
    const style = getComputedStyle(document.documentElement);
    const ink = style.getPropertyValue("--ink-2").trim();
    const grid = { stroke: style.getPropertyValue("--line").trim(), width: 1 };
    const draw = () => {
      if (document.hidden || !place.current) return;
      const curves = plot.shown();
      const key = JSON.stringify([curves.map((one) => [one.label, one.unit]), place.current.clientWidth]);
      if (key !== drawn) {
        drawn = key;
        chart?.destroy();
        chart = curves.length ? build(curves, ink, grid) : null;
        count = -1;
      }
      const state = plot.count + seconds * 1e9 + (plot.frozen === null ? 0 : 0.5);
      if (chart && state !== count && !chart.isHeld) {
        count = state;
        chart.setData(tables(curves));
      }
    };
    const build = (curves, stroke, lines) => {
      const units = [...new Set(curves.map((one) => one.unit))]; // each has a scale of its own; the first two have axes
      const axis = (scale, side) => ({ scale, side, stroke, grid: side === 3 ? lines : { show: false }, ticks: lines, size: 52, font: "11px sans-serif",
        label: scale || undefined, labelSize: scale ? 16 : 0, labelFont: "11px sans-serif",
        values: (_, ticks) => ticks.map((one) => (Math.abs(one) >= 1e5 ? one.toExponential(0) : String(Number(one.toFixed(6))))) });
      const value = (_, one) => (one === null || one === undefined ? "–" : Number(one.toPrecision(5)).toString());
      const made = new uPlot({
        width: place.current.clientWidth, height: 220, scales: { x: { time: false }, ...Object.fromEntries(units.map((unit) => [unit, { range: padded }])) },
        legend: { live: true }, cursor: { sync: { key: "time" }, drag: { x: true, y: false } },
        axes: [{ stroke, grid: lines, ticks: lines, font: "11px sans-serif", size: 32, values: (_, ticks) => ticks.map((one) => `${Number(one.toFixed(3))}`) },
          ...units.slice(0, 2).map((unit, at) => axis(unit, at ? 1 : 3))],
        series: [{ label: "Time, s", value: (_, one) => (one === null || one === undefined ? "–" : one.toFixed(3)) },
          ...curves.map((one, at) => ({ label: one.unit ? `${one.label}, ${one.unit}` : one.label, stroke: COLOURS[at % COLOURS.length], width: 1.6,
            scale: one.unit, value, points: { show: false } }))],
        hooks: { setSelect: [(self) => { self.isHeld = self.select.width > 0; }] },
      }, tables(curves), place.current);
      made.over.addEventListener("dblclick", () => { made.isHeld = false; });
      return made;
    };
    draw();
    const timer = setInterval(draw, DRAW_MS);
    return () => {
      clearInterval(timer);
      chart?.destroy();
    };
  }, [plot, dark]);
  return html`<div class="chart" ref=${place}></div>`;
}

function saveCsv(plot) {
  const curves = plot.shown();
  const times = [...new Set(curves.flatMap((one) => one.times))].sort((one, other) => one - other);
  const columns = curves.map((one) => new Map(one.times.map((time, place) => [time, one.values[place]])));
  const quoted = (text) => (/[",\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
  const lines = [["%time", ...curves.map((one) => quoted(one.label))].join(",")];
  for (const time of times) lines.push([Math.round(time * 1e9), ...columns.map((column) => column.get(time) ?? "")].join(","));
  download(`plot${plot.id}.csv`, `${lines.join("\n")}\n`, "text/csv");
}

function Plot({ plot }) {
  const paused = useStore((s) => s.status?.paused);
  const troubles = Object.values(plot.troubles);
  const isEmpty = !plot.curves.length;
  const choose = (derived) => {
    plot.derived = derived;
    changed();
  };
  return html`<section class="plot">
    <header><span class="name whole" title=${plot.fields.join("\n")}>${plot.fields.length ? inParts(shortened(plot.fields).join(", ")) : "Plot"}</span>
      <${Select} label="Derived curve" value=${plot.derived} options=${[["values", "Values"], ["derivative", "Derivative"], ["difference", "Difference to the first"]]} onChange=${choose} />
      <${Button} icon=${plot.frozen === null ? "pause" : "play"} title=${plot.frozen === null ? "Pause the plot" : "Go on with the plot"}
        aria-pressed=${plot.frozen !== null} onClick=${() => plot.pause()} />
      <${Button} disabled=${isEmpty} onClick=${() => saveCsv(plot)}>CSV<//>
      <${Button} icon="close" title="Remove the plot" onClick=${() => { isTouched = true; plot.remove(); }} /></header>
    ${troubles.map((text) => html`<em class="error" key=${text}>${text}</em>`)}
    ${isEmpty && !troubles.length && html`<p class="empty">No message has come yet${paused ? ": the simulation is paused" : ""}.</p>`}
    <${Chart} plot=${plot} />
  </section>`;
}

function Panel() {
  const shown = useStore((s) => s.plots) ?? [];
  const topics = useStore((s) => s.topics);
  const [text, setText] = useState("");
  const [into, setInto] = useState("new");
  const [error, setError] = useState("");
  const [window, setWindow] = useState(String(seconds));
  useEffect(() => {
    isShown = true;
    if (!plots.length && !given.length && !isTouched && store.values.status) plotFirst();
    return () => { isShown = false; };
  }, []);
  const span = Number(window);
  const isGood = window.trim() !== "" && span >= 1 && span <= LONGEST_S;
  const plot = async (event) => {
    event.preventDefault();
    try {
      if (!text.trim()) throw Object.assign(new Error("No field to plot"), { hint: "Write one, as joint_states/position[0]." });
      await add(text.trim(), into);
      setError("");
    } catch (refused) {
      setError(reasonOf(refused));
    }
  };
  const setSpan = (value) => {
    setWindow(value);
    const to = Number(value);
    if (value.trim() === "" || !(to >= 1 && to <= LONGEST_S)) return;
    seconds = to;
    localStorage.setItem("slidectl.window", value);
  };
  return html`
    <form class="plot-form" onSubmit=${plot}>
      <${Field} label="Field" error=${error}><input list="topics-to-plot" aria-label="Plot field" placeholder="joint_states/position[0]" value=${text}
        aria-invalid=${!!error} onInput=${(event) => { setText(event.target.value); setError(""); }} />
        <datalist id="topics-to-plot">${Object.values(topics).filter((one) => one.publishers.length).map((one) => html`<option value=${one.name} />`)}</datalist><//>
      <div class="line"><${Select} label="Into plot" value=${into} options=${[["new", "New plot"], ...shown.map((one, place) => [String(one.id), `Plot ${place + 1}`])]} onChange=${setInto} />
        <button type="submit" class="button primary">Plot</button>
        <label class="window"><span>Window, s</span><input class="short" inputmode="numeric" value=${window} aria-invalid=${!isGood}
          title=${isGood ? "" : `From 1 to ${LONGEST_S}`} onInput=${(event) => setSpan(event.target.value)} /></label></div>
    </form>
    ${shown.map((one) => html`<${Plot} key=${one.id} plot=${one} />`)}
    ${!shown.length && html`<p class="empty">No plots. Write a field, or choose one in Topics.</p>`}`;
}

export const plotsPanel = { title: "Plots", Panel };
