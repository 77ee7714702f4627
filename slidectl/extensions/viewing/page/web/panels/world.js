// The whole world: snapshots and recordings.

import {
  act, Act, Button, call, Empty, Field, Group, html, notify, number, page, useEvery, useState, useStore,
} from "../parts.js";

function Snapshots() {
  const [list, setList] = useState([]);
  const [name, setName] = useState("here");
  const read = () => call("/slidectl/snapshots").then((answer) => setList(answer.snapshots)).catch(() => {});
  useEvery(2000, read);
  const save = async () => {
    const { time } = await call("/slidectl/save", { name });
    notify(`${name} saved at ${number(time)} s`, "", "good");
    read();
  };
  const load = async (one) => {
    const { time } = await call("/slidectl/load", { name: one });
    notify(`${one} loaded: it is ${number(time)} s`, "", "good");
  };
  const forget = async (one) => {
    await call("/slidectl/delete_snapshots", { names: [one] });
    read();
  };
  return html`<${Group} title="Snapshots">
    <div class="line"><input aria-label="Snapshot name" value=${name} maxlength="200" onInput=${(event) => setName(event.target.value)} />
      <${Act} onClick=${save}>Save<//></div>
    ${list.map((one) => html`<div class="row" key=${one.name}><span class="name" title=${one.robots.join(", ")}>${one.name}</span>
      <span class="value">${number(one.time)} s</span><${Act} onClick=${() => load(one.name)}>Load<//>
      <${Act} icon="close" title=${`Delete ${one.name}`} onClick=${() => forget(one.name)} /></div>`)}
    ${!list.length && html`<${Empty}>No snapshots yet. Save keeps the whole state under a name.<//>`}
  <//>`;
}

function Recording() {
  const recording = useStore((s) => s.pageState?.recording);
  const [file, setFile] = useState("run.bag");
  const [topics, setTopics] = useState("");
  return html`<${Group} title="Recording">
    ${recording
      ? html`<div class="row"><span class="name">${recording.file}</span><span class="value">${recording.text}</span></div>
          <div class="line end"><${Act} kind="recording" onClick=${() => page("stop_recording")}>Stop recording<//></div>`
      : html`<${Field} label="File, .bag or .mcap"><input value=${file} onInput=${(event) => setFile(event.target.value)} /><//>
          <${Field} label="Topics to record"><input value=${topics} placeholder="All" onInput=${(event) => setTopics(event.target.value)} /><//>
          <div class="line end"><${Act} onClick=${() => page("record", { file, topics })}>Record<//></div>`}
  <//>`;
}

function About() {
  const status = useStore((s) => s.status);
  if (!status) return null;
  const rows = [
    ["Daemon", status.instance],
    ["Cycles", String(status.cycles)],
    ["Time step", `${status.timestep} s`],
    ["Robots", String(status.robots.length)],
    ["Controllers running", `${status.controllers_running} of ${status.controllers}`],
    ["Cycle, mean", `${(1e6 * status.cycle_mean).toFixed(0)} µs`],
    ["Overruns", String(status.overruns)],
  ];
  return html`<${Group} title="Simulation">${rows.map(([name, value]) =>
    html`<div class="row" key=${name}><span class="name">${name}</span><span class="value">${value}</span></div>`)}<//>`;
}

const Panel = () => html`<${About} /><${Snapshots} /><${Recording} />`;

export const worldPanel = { title: "World", Panel };
