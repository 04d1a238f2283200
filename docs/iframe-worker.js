// A page that is read from a folder may not start a worker, and the search is one: here it runs in a hidden frame.
// With a server, the browser's own workers are used. (As npm's iframe-worker does, which would be fetched from elsewhere.)
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super()
      const frame = document.createElement("iframe")
      frame.hidden = true
      document.body.append(frame)
      this.frame = frame
      const inside = frame.contentWindow, outside = this
      inside.document.open()
      inside.document.write("<!doctype html><html><body></body></html>")
      inside.document.close()
      // What a worker posts arrives where a page listens to its worker.
      inside.postMessage = data => queueMicrotask(() => {
        const event = new MessageEvent("message", { data })
        outside.dispatchEvent(event)
        outside.onmessage?.(event)
      })
      const load = address => new Promise((resolve, reject) => {
        const script = inside.document.createElement("script")
        script.src = new URL(address, location.href).href
        script.onload = resolve
        script.onerror = reject
        inside.document.body.append(script)
      })
      inside.importScripts = (...addresses) =>
        addresses.reduce((before, address) => before.then(() => load(address)), Promise.resolve())
      this.ready = load(url)
    }
    postMessage(data) {
      this.ready.then(() => {
        const event = new MessageEvent("message", { data })
        this.frame.contentWindow.dispatchEvent(event)
      })
    }
    terminate() {
      this.frame.remove()
    }
  }
}
