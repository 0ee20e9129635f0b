const { environmentPlugin } = require('esbuild-plugin-environment');
const { glsl } = require('esbuild-plugin-glsl');
const InlineCSSPlugin = require('esbuild-plugin-inline-css');
require('esbuild').build({
  entryPoints: ['entry.js'], format: 'iife', globalName: 'Plotly', bundle: true, minify: true,
  plugins: [InlineCSSPlugin(), glsl({ minify: true }), environmentPlugin({ NODE_DEBUG: false })],
  alias: { stream: 'stream-browserify' }, define: { global: 'window', 'define.amd': 'false' },
  target: 'es2016', outfile: 'plotly.min.js', legalComments: 'inline', logLevel: 'warning',
}).catch(() => process.exit(1));
