// Search in pages opened from file://, where browsers start no workers: the worker's script runs
// in a hidden frame instead.  The theme looks for a class, and a file, of this name.
class IFrameWorker extends EventTarget {
  constructor(address) {
    super();
    this.onmessage = null;
    const frame = document.createElement("iframe");
    frame.hidden = true;
    document.body.append(frame);
    this.frame = frame;
    const inside = frame.contentWindow;
    const run = (script) => new Promise((done, failed) => {
      const element = inside.document.createElement("script");
      element.addEventListener("load", done);
      element.addEventListener("error", failed);
      element.src = script;
      inside.document.body.append(element);
    });
    inside.importScripts = async (...scripts) => {
      for (const script of scripts) await run(script);
    };
    inside.postMessage = (data) => this.hear(data);
    this.ready = run(address);
  }

  hear(data) {
    const event = new MessageEvent("message", { data });
    this.dispatchEvent(event);
    if (this.onmessage) this.onmessage(event);
  }

  postMessage(data) {
    const inside = this.frame.contentWindow;
    this.ready.then(() => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
  }

  terminate() {
    this.frame.remove();
  }
}

window.IFrameWorker = IFrameWorker;
if (location.protocol === "file:") window.Worker = IFrameWorker;
