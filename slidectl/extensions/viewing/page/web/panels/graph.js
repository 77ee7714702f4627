// The graph of nodes and topics as a picture, and the tree of tf frames with their ages.

import { attempt, Button, Check, Field, Group, html, inParts, page, reasonOf, store, useEffect, useEvery, useRef, useState, useStore } from "../parts.js";

function Picture() {
  const topics = useStore((s) => s.topics);
  const [words, setWords] = useState("");
  const [address, setAddress] = useState("");
  const [error, setError] = useState("");
  const [large, setLarge] = useState(false);
  const read = async () => {
    try {
      const { svg } = await page("graph", { of: words });
      // A picture cannot run scripts, whatever names are in it.
      setAddress(URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" })));
      setError("");
    } catch (refused) {
      setError(reasonOf(refused));
    }
  };
  useEffect(() => {
    const timer = setTimeout(read, 300);
    return () => clearTimeout(timer);
  }, [words, topics]);
  useEffect(() => () => address && URL.revokeObjectURL(address), [address]);
  return html`<${Group} title="Nodes and topics" aside=${html`<${Button} onClick=${read}>Refresh<//>`}>
    <${Field} label="Graph of" hint="Nodes, topics or namespaces" error=${error}>
      <input value=${words} placeholder="All" onInput=${(event) => setWords(event.target.value)} /><//>
    ${address && html`<button type="button" class=${`graph ${large ? "large" : ""}`} title=${large ? "Make it fit" : "Enlarge"}
      onClick=${() => setLarge(!large)}><img src=${address} alt="Graph of nodes and topics" /></button>
      <p class="hint">${large ? "Click the graph to make it fit." : "Click the graph to enlarge it."}</p>`}
  <//>`;
}

function Frames() {
  const [followed, setFollowed] = useState(false);
  const [, again] = useState(0);
  const frames = useRef(new Map());
  useEffect(() => {
    frames.current = new Map();
    if (!followed) return undefined;
    const take = (isStatic) => (msg) => {
      for (const one of msg.transforms) {
        const { secs, nsecs } = one.header.stamp;
        frames.current.set(one.child_frame_id, { parent: one.header.frame_id, time: secs + nsecs / 1e9, isStatic });
      }
    };
    const ends = [["/tf", false], ["/tf_static", true]].map(([topic, isStatic]) =>
      store.values.ros.subscribe(topic, take(isStatic), { type: "tf2_msgs/TFMessage", queue: 1000 }));
    return () => ends.forEach((end) => end());
  }, [followed]);
  useEvery(500, () => followed && again((count) => count + 1), followed);
  const now = store.values.time ?? 0;
  const inner = new Map();
  for (const [child, { parent }] of frames.current) inner.set(parent, [...(inner.get(parent) ?? []), child]);
  const roots = [...inner.keys()].filter((name) => !frames.current.has(name)).sort();
  const seen = new Set();
  const Frame = ({ name }) => {
    if (seen.has(name)) return null; // frames in a circle
    seen.add(name);
    const one = frames.current.get(name);
    const age = one ? (one.isStatic ? "static" : `${Math.max(0, now - one.time).toFixed(1)} s`) : "";
    return html`<li><span>${inParts(name)}</span> <i>${age}</i>${inner.has(name) && html`<ul>${inner.get(name).sort().map((child) =>
      html`<${Frame} key=${child} name=${child} />`)}</ul>`}</li>`;
  };
  return html`<${Group} title="Frames">
    <${Check} checked=${followed} onChange=${setFollowed}>Follow the tf tree<//>
    ${followed && (roots.length ? html`<ul class="tree">${roots.map((name) => html`<${Frame} key=${name} name=${name} />`)}</ul>`
      : html`<p class="empty">No frames yet.</p>`)}
  <//>`;
}

const Panel = () => html`<${Picture} /><${Frames} />`;

export const graphPanel = { title: "Graph", Panel };
