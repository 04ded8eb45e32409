# The project's commands; each is plain cargo, so that `just` is a convenience only.

# The main job on the built-in clip.
demo:
    cargo run --release -- demo

# All tests.
test:
    cargo test --workspace

# What CI runs.
ci:
    .ci/run

# Accuracy on scenes of known truth: the tables of docs/accuracy.md.
validate *ARGS:
    cargo run --release -- validate {{ARGS}}

# Kernels: synthesis, analysis and fits.
bench:
    cargo bench -p blindaug

# What a page needs, built for the web.
wasm:
    tools/check-wasm.sh

# The npm package and its page, in Node and Chromium; needs Node.js, npm's registry, chromium and ffmpeg.
web *ARGS:
    web/check.sh {{ARGS}}

# The exported three.js module in Chromium; needs Node.js, npm's registry and chromium.
three *ARGS:
    tools/check-three.sh {{ARGS}}

# The questionnaire of the user study in Chromium; needs Node.js, npm's registry and chromium.
study *ARGS:
    tools/check-study.sh {{ARGS}}

# The loop through Blender: exported, rendered, estimated; needs Python 3.11.
blender *ARGS:
    tools/check-blender.sh {{ARGS}}

# The exported film grain table through an AV1 encoder and decoder; needs aom-tools and dav1d.
av1:
    tools/check-av1.sh

# The exported grain shaders, run and compared with the reference; those in HLSL need glslang-tools.
shaders:
    cargo test -p blindaug-gpu --test exported -- --nocapture

# What the GPU's passes cost: bytes, taps and times.
bench-gpu *ARGS:
    cargo bench -p blindaug-gpu --bench composite -- {{ARGS}}

# Damaged files into every reader, or into one for some seconds; needs cargo-fuzz.
fuzz *ARGS:
    tools/fuzz.sh {{ARGS}}

# Runs that are killed at random moments and run again.
kills *ARGS:
    tools/check-kills.sh {{ARGS}}

# The plugin for Bevy: built, linted, tested.
bevy:
    engines/bevy/check.sh

# The OpenFX plugin: built, linted, tested, and run in OpenFX's demo host; needs g++ and libexpat1-dev.
ofx:
    engines/ofx/check.sh

# The add-on for Blender: built, installed, tested through renders; needs Python 3.11 and PyPI.
blender-addon:
    engines/blender/check.sh

# The Python package: built, linted, tested; needs Python 3.10 or later and PyPI.
python:
    python/check.sh

# Archives on Ray while workers, machines and drivers are killed; needs PyPI and some minutes.
archive:
    python/check-archive.sh

# The job for render farms, by ranges of frames and with a killed task; needs PyPI.
farm:
    engines/openjd/check.sh

# The programs and wheels of a release, for every platform whose toolchain is at hand.
release *ARGS:
    tools/release.sh {{ARGS}}

# Licences and sources of the dependencies; needs cargo-deny.
deny:
    cargo deny --all-features check licenses sources bans

# What the program computes: recorded before a change, compared after it.
unchanged WHAT FOLDER:
    tools/check-unchanged.sh {{WHAT}} {{FOLDER}}
