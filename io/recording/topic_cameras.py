"""The cameras among the topics of recordings: those whose messages carry images, with the lens that comes along."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from quadrig.io.recording.camera import FIRST_IMAGES, RecordedCamera, camera_name, camera_of_source
from quadrig.io.recording.decode_image import decode_image, is_depth
from quadrig.io.recording.image_source import McapImages
from quadrig.io.recording.messages.image_message import holds_images, holds_lenses, holds_video, read_lens
from quadrig.io.recording.messages.mcap_messages import McapMessages
from quadrig.io.recording.messages.mcap_reader import McapIndex, TopicMessages
from quadrig.io.recording.picture_header import read_header
from quadrig.io.recording.video import McapVideo


def cameras_of_mcaps(
    indexes: Sequence[McapIndex], wanted: Mapping[str, str | None], notes: list[str]
) -> tuple[list[RecordedCamera], tuple[tuple[str, str, int], ...]]:
    """Cameras of the image topics, and the other topics: name, schema, messages."""
    groups: dict[str, list[TopicMessages]] = {}
    others: dict[str, tuple[str, str, int]] = {}
    priors: dict[str, TopicMessages] = {}
    for topic in (topic for index in indexes for topic in index.topics):
        if holds_images(topic.encoding, topic.schema) and len(topic):
            groups.setdefault(topic.topic, []).append(topic)
            continue
        if holds_lenses(topic.encoding, topic.schema) and len(topic):
            priors.setdefault(camera_name(topic.topic), topic)
        _, _, before = others.get(topic.topic, ("", "", 0))
        others[topic.topic] = (topic.topic, topic.schema or topic.encoding, before + len(topic))
    cameras = []
    asked = {topic for topic in wanted.values() if topic}
    for name, topics in sorted(groups.items()):
        camera = _camera_of_topic(name, topics, name in asked, notes)
        if camera is None:
            others[name] = (name, topics[0].schema, sum(len(topic) for topic in topics))
        else:
            cameras.append(_with_prior(camera, priors, notes))
    return cameras, tuple(others[name] for name in sorted(others))


def _camera_of_topic(
    name: str, topics: Sequence[TopicMessages], asked: bool, notes: list[str]
) -> RecordedCamera | None:
    messages = McapMessages.of(topics)
    reason = "there are none"
    with messages.opened() as opened:
        sizes: dict[int, tuple[int, int]] = {}
        for index in _sample(len(messages)):
            try:
                coded = opened.image(index)
                if is_depth(coded.encoding) and not asked:
                    notes.append(f"topic {name} holds depths ({coded.encoding}), not images, and is not used")
                    return None
                if holds_video(messages.schema):
                    return camera_of_source(camera_name(name), name, McapVideo(messages, coded.encoding))
                sizes[index] = read_header(coded.data).size if coded.width == 0 else (coded.width, coded.height)
            except ValueError as error:
                reason = str(error)
        count = Counter(sizes.values())
        for index in sorted(sizes, key=lambda one: -count[sizes[one]]):
            try:
                coded = opened.image(index)
                height, width = decode_image(coded).shape
            except ValueError as error:
                reason = str(error)
                continue
            if coded.width == 0 and (turned := read_header(coded.data).turned):
                notes.append(f"topic {name}: its pictures are {turned}, as their EXIF says")
            return RecordedCamera(camera_name(name), name, width, height, McapImages(messages, coded.encoding))
    notes.append(f"topic {name} is not used: its images cannot be read ({reason})")
    return None


def _sample(count: int) -> list[int]:
    """The images that a topic's size is taken from: the first, and as many over all, for the first may be odd."""
    spread = np.linspace(0, count - 1, min(FIRST_IMAGES, count)).round().astype(int)
    return sorted({*range(min(FIRST_IMAGES, count)), *spread.tolist()})


def _with_prior(camera: RecordedCamera, priors: Mapping[str, TopicMessages], notes: list[str]) -> RecordedCamera:
    topic = priors.get(camera.name)
    if topic is None:
        return camera
    try:
        with McapMessages.of([topic]).opened() as opened:
            lens, remark = read_lens(topic.encoding, topic.schema, opened.data(0))
    except ValueError:
        notes.append(f"topic {topic.topic} cannot be read; camera {camera.name!r} has no lens to begin with")
        return camera
    if remark:
        notes.append(f"camera {camera.name!r}: {remark}")
    if lens is not None and (lens.width, lens.height) != (camera.width, camera.height):
        notes.append(
            f"camera {camera.name!r}: {topic.topic} is for {lens.width}x{lens.height} images, its images are "
            f"{camera.width}x{camera.height}; the lens is not used"
        )
        return camera
    return camera if lens is None else replace(camera, prior=lens)
