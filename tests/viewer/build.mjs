// Bundles the viewer into the folder that is given: the page, its script, the worker that decodes, and its codec.
import { copyFileSync, mkdirSync, writeFileSync } from "node:fs";
import { createRequire } from "node:module";
import { dirname, join } from "node:path";
import { fileURLToPath } from "node:url";
import { build } from "esbuild";

const here = dirname(fileURLToPath(import.meta.url));
const out = process.argv[2] ?? join(here, "dist");
mkdirSync(out, { recursive: true });
// Parts of codecs that run under Node alone.
const node = ["fs", "path", "crypto", "module", "worker_threads", "os", "url", "util", "perf_hooks", "node:*"];
// vtk.js writes XML with it, which needs Node and which no viewer asks for.
const withoutXml = {
  name: "without xml",
  setup(bundle) {
    bundle.onResolve({ filter: /^xmlbuilder2$/ }, () => ({ path: "xmlbuilder2", namespace: "empty" }));
    bundle.onLoad({ filter: /.*/, namespace: "empty" }, () => ({ contents: "module.exports = {};" }));
  },
};
const loader = join(here, "node_modules/@cornerstonejs/dicom-image-loader/dist/esm");
await build({
  entryPoints: { viewer: join(here, "viewer.js"), decodeImageFrameWorker: join(loader, "decodeImageFrameWorker.js") },
  bundle: true, format: "esm", outdir: out, external: node, plugins: [withoutXml],
  logLevel: "error",
});
const require = createRequire(join(loader, "index.js"));
copyFileSync(require.resolve("@cornerstonejs/codec-charls/decodewasm"), join(out, "charlswasm_decode.wasm"));
writeFileSync(join(out, "index.html"), '<!doctype html><script type="module" src="viewer.js"></script>\n');
