// Chosen view: the camera, and the layers over its picture.

import { desk } from "../connection/desk.js";
import { find, press } from "../elements/dom.js";
import { showLive } from "./tools.js";
import { COMPUTED } from "./video.js";

/** Wire the buttons of cameras and layers. */
export function wireLooks(overlay) {
  for (const button of document.querySelectorAll("[data-camera]")) {
    button.addEventListener("click", () => {
      if (button.dataset.camera !== desk.video.camera) showLive(); // outlines must match the picture's camera
      desk.video.look({ camera: button.dataset.camera });
      overlay.forget(...COMPUTED);
      press(button, true);
      for (const other of button.parentElement.children) if (other !== button) press(other, false);
      desk.changed();
    });
  }
  for (const button of document.querySelectorAll("[data-layer]")) {
    const apply = () => {
      const on = button.getAttribute("aria-pressed") === "true";
      find("stage").classList.toggle(`without-${button.dataset.layer}`, !on);
      if (!COMPUTED.includes(button.dataset.layer)) return;
      desk.video.look({ [button.dataset.layer]: on });
      overlay.forget(button.dataset.layer);
    };
    apply();
    button.addEventListener("click", () => {
      press(button, button.getAttribute("aria-pressed") !== "true");
      apply();
    });
  }
}
