"""Upload of files: by a button, or dropped anywhere on the page."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, ClassVar

import param
from panel.custom import JSComponent

from deadtime.app import uploaded_log
from deadtime.problems.toml import MOST_BYTES

_MOST = {"csv": uploaded_log.MOST_BYTES, "toml": MOST_BYTES}

Take = Callable[[str, int, bytes | None], None]


class FileUpload(JSComponent):
    """A button that opens a file, and a page that takes what is dropped on it.

    A file larger than its kind may be is not sent: only its name and size are.
    """

    label = param.String(default="Open a problem or a log")
    most = param.Dict(default=_MOST, doc="The most bytes of a file, by its ending.")

    _stylesheets: ClassVar = [
        """
        button { width: 100%; padding: 7px 12px; border: 0; border-radius: 4px; cursor: pointer;
                 font: inherit; font-weight: 500; background: #1976d2; color: #fff; }
        button:hover { background: #125ea8; }
        button:focus-visible { outline: 3px solid #7ab8e0; outline-offset: 2px; }
        .hint { font-size: 0.8rem; opacity: 0.8; margin: 4px 2px 0; color: inherit; }
        """
    ]
    # Bokeh takes the size of panels that replace others before it has laid them out, where the page
    # is resized meanwhile, and fails: here they wait until they are.
    _esm = """
    const panel = window.Bokeh?.Models.get("Figure").prototype.default_view.prototype ?? {};
    for (const name of ["_measure_layout", "_after_layout"]) {
      const own = panel[name];
      if (own) {
        panel[name] = function () { if (this.layout != null) { own.call(this); } };
      }
    }

    function over(event) {
      return event.dataTransfer && Array.from(event.dataTransfer.types).includes("Files");
    }

    function veil() {
      const one = document.createElement("div");
      one.className = "drop-here";
      one.textContent = "Drop a log (.csv) or a problem file (.toml)";
      one.style.cssText = "position:fixed; inset:0; z-index:9999; display:none; padding:20px;" +
        "align-items:center; justify-content:center; text-align:center; pointer-events:none;" +
        "font:600 1.4rem system-ui,sans-serif; color:#fff; background:rgba(0,66,107,0.82);" +
        "outline:4px dashed #fff; outline-offset:-16px;";
      document.body.appendChild(one);
      return one;
    }

    export function render({model}) {
      const root = document.createElement("div");
      const button = document.createElement("button");
      const input = document.createElement("input");
      const hint = document.createElement("div");
      button.type = "button";
      button.textContent = model.label;
      hint.className = "hint";
      hint.textContent = ".toml or .csv; or drop one anywhere on this page.";
      input.type = "file";
      input.accept = Object.keys(model.most).map((kind) => "." + kind).join(",");
      input.hidden = true;

      async function take(files) {
        if (files.length !== 1) {
          model.send_msg({count: files.length});
          return;
        }
        const file = files[0];
        const most = model.most[file.name.split(".").pop().toLowerCase()] || 0;
        const content = file.size > most ? null : await file.arrayBuffer();
        model.send_msg({name: file.name, size: file.size, content});
      }

      button.onclick = () => input.click();
      input.onchange = async () => {
        if (input.files.length) {
          await take(Array.from(input.files));
          input.value = "";  // the same file may be opened again
        }
      };

      const sheet = veil();
      let depth = 0;
      const show = () => { sheet.style.display = depth > 0 ? "flex" : "none"; };
      const on = {
        dragenter: (event) => { if (over(event)) { event.preventDefault(); depth += 1; show(); } },
        dragover: (event) => {
          if (over(event)) { event.preventDefault(); event.dataTransfer.dropEffect = "copy"; }
        },
        dragleave: (event) => { if (over(event)) { depth = Math.max(0, depth - 1); show(); } },
        drop: (event) => {
          if (!over(event)) { return; }
          event.preventDefault();
          event.stopPropagation();
          depth = 0;
          show();
          take(Array.from(event.dataTransfer.files));
        },
      };
      for (const name in on) { window.addEventListener(name, on[name], true); }
      model.on("remove", () => {
        for (const name in on) { window.removeEventListener(name, on[name], true); }
        sheet.remove();
      });
      root.append(button, input, hint);
      return root;
    }
    """

    def __init__(self, take: Take, refuse: Callable[[str], None], **given: Any) -> None:
        super().__init__(**given)
        self._take, self._refuse = take, refuse

    def _handle_msg(self, data: Any) -> None:
        if "count" in data:
            self._refuse(f"{data['count']} files came at once: drop one at a time.")
            return
        content = data["content"]
        size = data["size"] if content is None else len(content)
        self._take(str(data["name"]), int(size), None if content is None else bytes(content))
