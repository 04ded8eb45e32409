"""Whatever is handed in, by the thousands: a result, or an exception that names the argument."""

import numpy as np
import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import blindaug as ba

# A function-scoped fixture is not used, and times differ between machines.
COMMON = settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large])

TYPES = ["uint8", "uint16", "float16", "float32", "float64", ">f4", "int8", "int64", "bool", "complex64", "U2", "M8[s]", "O"]
SHAPES = st.one_of(
    hnp.array_shapes(min_dims=0, max_dims=5, min_side=0, max_side=7),
    st.sampled_from([(5, 6, 3), (5, 6, 4), (5, 6, 2), (5, 6), (2, 5, 6, 3), (5, 6, 1)]),
)


@st.composite
def arrays(draw, shapes=SHAPES):
    """Arrays of any type and shape, with any numbers, turned, strided, backward or read-only."""
    kind = draw(st.sampled_from(TYPES))
    shape = draw(shapes)
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    array = rng.random(shape)
    if kind == "O":
        array = np.asarray(array, object)
    elif np.dtype(kind).kind in "iu":
        array = (array * 100).astype(kind)
    elif np.dtype(kind).kind == "M":
        array = (array * 1e9).astype("int64").astype(kind)
    else:
        array = array.astype(kind)
    # What is computed of an array without axes is no array.
    array = np.asarray(array)
    if np.dtype(kind).kind == "f" and array.size and draw(st.booleans()):
        array[tuple(draw(st.integers(0, n - 1)) for n in shape)] = draw(
            st.sampled_from([np.nan, np.inf, -np.inf, -1.0, 1e30, 1e-45, 255.0])
        )
    layout = draw(st.sampled_from(["plain", "backward", "turned", "every second", "read-only", "broadcast"]))
    if layout == "backward" and array.ndim:
        array = array[::-1]
    elif layout == "turned":
        array = array.T
    elif layout == "every second" and array.ndim:
        array = np.repeat(array, 2, axis=-1)[..., ::2]
    elif layout == "broadcast" and array.ndim:
        array = np.broadcast_to(array[:1], array.shape)
    elif layout == "read-only":
        array.setflags(write=False)
    return array


ANYTHING = st.one_of(
    arrays(),
    st.none(),
    st.booleans(),
    st.integers(),
    st.floats(),
    st.text(max_size=5),
    st.binary(max_size=5),
    st.lists(st.one_of(arrays(), st.none(), st.floats()), max_size=3),
    st.tuples(st.floats(), st.floats()),
    st.dictionaries(st.integers(), st.floats(), max_size=2),
)
NAMES = ("footage", "frame", "layer", "rgb", "depth", "flow", "holdout", "match_at", "clean", "fps", "number", "method", "cam")


def tried(call):
    """What a call gives, or None after an exception that a caller can tell from one of its own code."""
    try:
        return call()
    except ba.FileError:
        return None
    except ba.Error as e:
        sentence = str(e)
        assert "\n" not in sentence and sentence.startswith(tuple(f"{name}: " for name in NAMES) + ("layer_", "with", "unknown: ", "product: "))
        return None
    except (TypeError, OverflowError) as e:
        # pyo3's own sentence for an argument that is no number or no text at all; a note names the argument.
        assert any("argument '" in text or "while processing '" in text for text in [str(e), *getattr(e, "__notes__", [])]), e
        return None


def valid(made, frame):
    assert made.dtype == frame.dtype.newbyteorder("=") and made.shape == frame.shape


FRAME = np.full((5, 6, 3), 99, np.uint8)
LAYER = np.full((5, 6, 4), 0.5, np.float32)


@pytest.fixture(scope="module")
def cam(camera):
    return camera


@COMMON
@given(footage=ANYTHING)
@example(footage=np.zeros((1, 1, 1, 3)))
def test_any_footage(footage):
    # A name of a file is another matter.
    if not isinstance(footage, (str, bytes)):
        made = tried(lambda: ba.estimate(footage))
        assert made is None or isinstance(made, ba.Camera)


@COMMON
@given(data=st.data())
def test_any_arguments_of_a_composite(cam, data):
    names = ["layer_depth", "layer_motion", "depth", "flow", "with_", "without", "holdout", "match_at"]
    chosen = data.draw(st.lists(st.sampled_from(names), unique=True, max_size=2))
    arguments = {name: data.draw(ANYTHING, label=name) for name in chosen}
    frame = data.draw(st.one_of(st.just(FRAME), arrays(st.just((5, 6, 3)))))
    layer = data.draw(st.one_of(st.just(LAYER), arrays(st.just((5, 6, 4)))))
    made = tried(lambda: ba.composite(frame, layer, cam, **arguments))
    if made is not None:
        valid(made, frame)


@COMMON
@given(rgb=ANYTHING, depth=ANYTHING, flow=ANYTHING, number=st.integers(-2, 2**70))
def test_any_arguments_of_apply(cam, rgb, depth, flow, number):
    made = tried(lambda: ba.apply(rgb, cam, depth=depth, flow=flow, number=number))
    if made is not None:
        valid(made, np.asarray(rgb))


@COMMON
@given(frames=st.lists(st.one_of(st.just(FRAME), ANYTHING), max_size=4), number=st.one_of(st.none(), st.integers(0, 5)))
def test_any_frames_of_a_tracker(frames, number):
    tracker = ba.Tracker()
    for frame in frames:
        made = tried(lambda: tracker.push(frame, number=number))
        assert made is None or isinstance(made, ba.Camera)
    tried(tracker.finish)


@COMMON
@given(text=st.one_of(st.text(max_size=80), st.from_regex(r'\{"format":"blindaug-camera","version":[0-9],.{0,60}\}')))
def test_any_text_as_a_camera(text):
    with pytest.raises(ba.Error, match="^text: "):
        ba.Camera.from_json(text)


def test_a_crash_would_be_seen():
    """Negative control: what does not name the argument is no sentence that passes."""

    def unnamed():
        raise ba.Error("something is wrong")

    with pytest.raises(AssertionError):
        tried(unnamed)
    with pytest.raises(ZeroDivisionError):
        tried(lambda: 1 / 0)
