// What OHIF does with an instance: metadata and frames over DICOMweb, a window on what it shows.
import * as core from "@cornerstonejs/core";
import dicomImageLoader from "@cornerstonejs/dicom-image-loader";

const { wadors } = dicomImageLoader;

window.start = async () => {
  await core.init();
  dicomImageLoader.init({ maxWebWorkers: 1, wasmBasePath: new URL(".", location.href).href });
  return "started";
};

// address: of an instance; frame: from 1; voiFunction: put into its shared functional groups where given.
// The pixels as base64 of a typed array, in the order of the rows.
window.show = async (address, frame, voiFunction) => {
  const [metadata] = await (await fetch(`${address}/metadata`)).json();
  if (voiFunction) {
    const voi = metadata["52009229"].Value[0]["00289132"].Value[0];
    voi["00281056"] = { vr: "CS", Value: [voiFunction] };
  }
  wadors.metaDataManager.purge();
  wadors.metaDataManager.add(`wadors:${address}/frames/1`, structuredClone(metadata));
  const imageId = `wadors:${address}/frames/${frame}`;
  if (frame > 1) wadors.metaDataManager.add(imageId, structuredClone(metadata));
  const image = await core.imageLoader.loadImage(imageId, { preScale: { enabled: false } });
  const pixels = image.getPixelData();
  const bytes = new Uint8Array(pixels.buffer, pixels.byteOffset, pixels.byteLength);
  let text = "";
  for (let k = 0; k < bytes.length; k += 8192) text += String.fromCharCode(...bytes.subarray(k, k + 8192));
  const shown = {
    type: pixels.constructor.name, rows: image.rows, columns: image.columns, invert: image.invert,
    function: image.voiLUTFunction, center: image.windowCenter, width: image.windowWidth,
    spacing: [image.rowPixelSpacing, image.columnPixelSpacing], pixels: btoa(text),
  };
  try {
    // As a viewport does before it draws.
    const { windowLevel } = core.utilities;
    shown.range = windowLevel.toLowHighRange(image.windowWidth, image.windowCenter, image.voiLUTFunction);
  } catch (error) {
    shown.error = error.message;
  }
  return shown;
};
