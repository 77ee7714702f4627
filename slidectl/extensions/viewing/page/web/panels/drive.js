// The drive pad of a base: buttons and keys that move it while they are held. It stops when they are let go; `slidectl
// view` itself stops it when the browser sends nothing any more.

import { Button, Field, Group, html, isUnder, page, Select, useEffect, useRef, useState, useStore } from "../parts.js";

const TWIST = "geometry_msgs/Twist";
const PERIOD_MS = 50;
const KEYS = { ArrowUp: "forward", ArrowDown: "backward", ArrowLeft: "left", ArrowRight: "right" };
const MOTION = { forward: [1, 0, 0], backward: [-1, 0, 0], left: [0, 0, 1], right: [0, 0, -1], slideLeft: [0, 1, 0], slideRight: [0, -1, 0] };

export function Drive({ robot }) {
  const topics = useStore((s) => s.topics);
  const controllers = useStore((s) => s.controllers[robot.namespace]) ?? [];
  const readOnly = useStore((s) => s.readOnly);
  const [chosen, setChosen] = useState("");
  const [speed, setSpeed] = useState(0.5);
  const [turn, setTurn] = useState(1);
  const [held, setHeld] = useState([]);
  const now = useRef({ held: [], error: "" });
  const [error, setError] = useState("");
  const found = Object.values(topics).filter((one) => one.type === TWIST && one.subscribers.length && isUnder(one.name, robot.namespace))
    .map((one) => one.name);
  const topic = found.includes(chosen) ? chosen : found[0];
  const isDriven = held.length > 0;
  const slides = !controllers.some((one) => topic?.includes(`/${one.name}/`) && !/mecanum/i.test(one.type));
  now.current = { held, topic, speed, turn };

  const hold = (motion, on) => setHeld((before) => (on ? [...new Set([...before, motion])] : before.filter((one) => one !== motion)));
  const release = () => setHeld([]);
  useEffect(() => {
    addEventListener("blur", release);
    document.addEventListener("visibilitychange", release);
    return () => {
      removeEventListener("blur", release);
      document.removeEventListener("visibilitychange", release);
    };
  }, []);
  useEffect(() => {
    if (!isDriven) return undefined;
    const send = async (motions) => {
      const { topic: to, speed: v, turn: w } = now.current;
      const [x, y, z] = [0, 1, 2].map((place) => motions.reduce((sum, one) => sum + MOTION[one][place], 0));
      const twist = { linear: { x: x * v, y: y * v, z: 0 }, angular: { x: 0, y: 0, z: z * w } };
      await page("drive", { topic: to, twist }).then(() => setError(""), (refused) => setError(refused.message));
    };
    send(now.current.held);
    const timer = setInterval(() => send(now.current.held), PERIOD_MS);
    return () => {
      clearInterval(timer);
      send([]);
    };
  }, [isDriven]);
  if (!found.length) return null;
  const onKey = (on) => (event) => {
    const motion = KEYS[event.key];
    if (!motion || event.target.closest("input, select")) return;
    event.preventDefault();
    event.stopPropagation(); // viser moves the camera by these keys
    if (!event.repeat) hold(motion, on);
  };
  const pad = (motion, icon, title) => html`<${Button} kind=${held.includes(motion) ? "drive on" : "drive"} icon=${icon} title=${title}
    disabled=${readOnly} aria-pressed=${held.includes(motion)}
    onPointerDown=${(event) => { event.currentTarget.closest(".pad").focus(); event.preventDefault(); hold(motion, true); }}
    onPointerUp=${() => hold(motion, false)} onPointerLeave=${() => hold(motion, false)} onPointerCancel=${() => hold(motion, false)} />`;
  return html`<${Group} title="Drive">
    ${found.length > 1 && html`<${Field} label="Command topic"><${Select} label="Command topic" value=${topic} options=${found} onChange=${setChosen} /><//>`}
    <div class="driving">
      <div class="pad" tabindex="0" role="group" aria-label="Drive with the arrow keys" onKeyDown=${onKey(true)} onKeyUp=${onKey(false)} onBlur=${release}>
        ${slides ? pad("slideLeft", "back", "Slide left") : html`<span />`}${pad("forward", "up", "Forward")}${slides ? pad("slideRight", "forth", "Slide right") : html`<span />`}
        ${pad("left", "back", "Turn left")}${pad("backward", "down", "Backward")}${pad("right", "forth", "Turn right")}
      </div>
      <div>
        <${Speed} label="Speed, m/s" value=${speed} most=${3} onChange=${setSpeed} />
        <${Speed} label="Turning speed, rad/s" value=${turn} most=${3} onChange=${setTurn} />
      </div>
    </div>
    ${error ? html`<em class="error">${error}</em>` : html`<p class="hint">It moves while a button or an arrow key is held. Click the pad for the keys.</p>`}
  <//>`;
}

function Speed({ label, value, most, onChange }) {
  return html`<label class="speed"><span>${label} <b>${value.toFixed(2)}</b></span>
    <input type="range" min="0.05" max=${most} step="0.05" value=${value} style=${{ "--part": `${(100 * value) / most}%` }}
      onInput=${(event) => onChange(Number(event.target.value))} /></label>`;
}
