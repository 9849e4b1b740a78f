"""What a person's hand does with a file over a page, as the events that a browser makes of it."""

_DROP = """([name, text, size, kinds]) => {
  const held = new DataTransfer();
  const content = size ? new Uint8Array(size).fill(35) : text;
  held.items.add(new File([content], name));
  for (const kind of kinds) {
    const given = {dataTransfer: held, bubbles: true, cancelable: true, composed: true};
    document.querySelector("main, body").dispatchEvent(new DragEvent(kind, given));
  }
}"""
_ALL = ("dragenter", "dragover", "drop")


def drop(page, name, text, kinds=_ALL):
    """Drop a file of this text anywhere on the page."""
    page.evaluate(_DROP, [name, text, 0, list(kinds)])


def drop_sized(page, name, size):
    """Drop a file of so many bytes."""
    page.evaluate(_DROP, [name, "", size, list(_ALL)])
