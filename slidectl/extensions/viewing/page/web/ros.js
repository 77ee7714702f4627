// The page's connection to the daemon: rosbridge over a WebSocket on the page's own port.

const RETRY_MS = 1000;
const CALL_MS = 60_000;
const DAEMON_GONE = [1012, 1013]; // the close codes of the page's own server when the daemon is not there

/** Who has gone when a connection is closed: "daemon", or "page", which may not have let this browser in. */
const goneOf = (code) => (DAEMON_GONE.includes(code) ? "daemon" : "page");
export const GONE = {
  daemon: "The daemon has gone",
  page: "slidectl view has ended, or does not let this browser in: start it again, and open the address that it prints",
};

/** What a service refused: its text, and a hint in the lines after the first. */
export class Refused extends Error {
  constructor(text) {
    const [first, ...rest] = String(text).split("\n");
    super(first);
    this.hint = rest.join("\n");
  }
}

export class Connection {
  constructor(url, onState) {
    this.url = url;
    this.onState = onState; // called with true, and with false and who has gone
    this.serial = 0;
    this.gone = "page";
    this.calls = new Map(); // id -> {resolve, reject, timer}
    this.topics = new Map(); // topic -> Map of subscription id -> {message, take}
    this.onStatus = () => {};
    this.connect();
  }

  connect() {
    this.socket = new WebSocket(this.url);
    this.socket.onopen = () => {
      for (const wishes of this.topics.values()) for (const wish of wishes.values()) this.send(wish.message);
      this.onState(true);
    };
    this.socket.onmessage = (event) => this.take(JSON.parse(event.data));
    this.socket.onclose = ({ code }) => {
      this.gone = goneOf(code);
      for (const call of this.calls.values()) call.reject(new Refused(GONE[this.gone]));
      this.calls.clear();
      this.onState(false, this.gone);
      setTimeout(() => this.connect(), RETRY_MS);
    };
  }

  get isOpen() {
    return this.socket.readyState === WebSocket.OPEN;
  }

  send(message) {
    if (this.isOpen) this.socket.send(JSON.stringify(message));
  }

  take(message) {
    if (message.op === "publish") {
      for (const wish of this.topics.get(message.topic)?.values() ?? []) wish.take(message.msg, message);
    } else if (message.op === "service_response") {
      const call = this.calls.get(message.id);
      if (!call) return;
      this.calls.delete(message.id);
      clearTimeout(call.timer);
      if (message.result === false) call.reject(new Refused(message.values));
      else call.resolve({ values: message.values, reasons: message.reasons ?? [] });
    } else if (message.op === "status") {
      const call = this.calls.get(message.id);
      if (!call) return this.onStatus(message);
      this.calls.delete(message.id);
      if (message.level === "error") call.reject(new Refused(message.msg));
      else call.resolve(message.reasons ?? []);
    }
  }

  /** The answer of a service with its `reasons`. Rejects with Refused, also for an answer with `success` or `ok` false. */
  ask(service, args = {}) {
    return new Promise((resolve, reject) => {
      if (!this.isOpen) return reject(new Refused(GONE[this.gone]));
      const id = `c${++this.serial}`;
      const late = () => {
        this.calls.delete(id);
        reject(new Refused(`${service} did not answer within ${CALL_MS / 1000} s`));
      };
      this.calls.set(id, { resolve, reject, timer: setTimeout(late, CALL_MS) });
      this.send({ op: "call_service", id, service, args });
    });
  }

  async call(service, args = {}) {
    const { values, reasons } = await this.ask(service, args);
    if (values.success === false || values.ok === false) {
      const text = values.status_message || values.message || reasons.join("\n");
      throw new Refused(text || `${service} refused`);
    }
    return values;
  }

  /** Publish; the remarks of the subscribers. Rejects with Refused when they do not take the message. */
  publish(topic, msg) {
    return new Promise((resolve, reject) => {
      if (!this.isOpen) return reject(new Refused(GONE[this.gone]));
      const id = `p${++this.serial}`;
      this.calls.set(id, { resolve, reject });
      this.send({ op: "publish", id, topic, msg, ack: true });
    });
  }

  /** Call `take(msg, envelope)` for each message; returns the function that ends it. The envelope has the `time`. */
  subscribe(topic, take, { type, throttle = 0, queue = 1 } = {}) {
    const id = `s${++this.serial}`;
    const message = { op: "subscribe", id, topic, throttle_rate: throttle, queue_length: queue, stamped: true };
    if (type) message.type = type;
    if (!this.topics.has(topic)) this.topics.set(topic, new Map());
    this.topics.get(topic).set(id, { message, take });
    this.send(message);
    return () => {
      const wishes = this.topics.get(topic);
      if (!wishes?.delete(id)) return;
      if (!wishes.size) this.topics.delete(topic);
      this.send({ op: "unsubscribe", id, topic });
    };
  }
}
