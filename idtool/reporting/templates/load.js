"use strict";
// A library that the page holds compressed, so that it is a third as large: gzip in base64.
async function load(id) {
  try {
    const packed = Uint8Array.from(atob(document.getElementById(id).textContent), (letter) => letter.charCodeAt(0));
    const whole = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    const script = document.createElement("script");
    script.textContent = await new Response(whole).text();
    document.head.append(script);
  } catch (error) {
    const text = "The plot needs a newer browser: Chrome 80, Firefox 113, Safari 16.4 or later.";
    document.querySelectorAll(".plot").forEach((plot) => { plot.textContent = text; });
    throw error;
  }
}
