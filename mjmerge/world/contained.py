"""A world without files: meshes written out, so that a recording of it stands for itself.

A car may bring meshes and textures as files. The text of the composed world would name them, and whoever
gets the recording has not got them; nor is a recording's world ever let near a file. So meshes are written
into the text, as MuJoCo read them, and the world is compiled from that. Textures are pictures of no
consequence: what has one is drawn in its material's colour.
"""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import mujoco
import numpy as np

from mjmerge.errors import ModelError

MOST_BYTES = 8_000_000
"""Of a world as text, its meshes included."""
_OURS = ("scale", "refpos", "refquat", "content_type", "file")
_AS_IT_IS = {"scale": "1 1 1", "refpos": "0 0 0", "refquat": "1 0 0 0"}


def contained(xml: str, assets: Mapping[str, bytes]) -> str:
    """The text of a world that names no file; the same text where it names none already.

    Args:
        xml: a world.
        assets: content of the files that it names.

    Raises:
        ValueError: it does not compile.
        ModelError: it names files that cannot be written out, or are too large for it.
    """
    if not assets:
        return xml
    model = mujoco.MjModel.from_xml_string(xml, dict(assets))
    root = ElementTree.fromstring(xml)
    pictures = set()
    for parent in list(root.iter()):
        for element in list(parent):
            if not any(name.startswith("file") for name in element.attrib):
                continue
            if element.tag == "mesh":
                _write_out(element, model)
            elif element.tag == "texture":
                pictures.add(element.get("name", ""))
                parent.remove(element)
            else:
                raise ModelError(
                    f"the <{element.tag}> {element.get('name', '')!r} is a file, and a recording stands for "
                    "itself: a car may have meshes and textures as files, and nothing else"
                )
    for parent in list(root.iter()):
        if parent.tag == "material" and parent.get("texture") in pictures:
            del parent.attrib["texture"]
        for layer in parent.findall("layer"):
            if layer.get("texture") in pictures:
                parent.remove(layer)
    text = ElementTree.tostring(root, encoding="unicode") + "\n"
    if len(text) > MOST_BYTES:
        raise ModelError(
            f"with its meshes the world has {len(text) / 1e6:.0f} MB of text, and the most is "
            f"{MOST_BYTES / 1e6:.0f} MB: give the car meshes with fewer vertices"
        )
    return text


def _write_out(element: ElementTree.Element, model: mujoco.MjModel) -> None:
    """A mesh with its vertices where the file has them, scaled as it is."""
    m = model.mesh(element.get("name", "")).id
    part = slice(model.mesh_vertadr[m], model.mesh_vertadr[m] + model.mesh_vertnum[m])
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, model.mesh_quat[m])
    vertices = model.mesh_vert[part].astype(float) @ turn.reshape(3, 3).T + model.mesh_pos[m]
    faces = model.mesh_face[model.mesh_faceadr[m] : model.mesh_faceadr[m] + model.mesh_facenum[m]]
    for name in _OURS:
        element.attrib.pop(name, None)
    element.attrib |= _AS_IT_IS
    element.set("vertex", " ".join(f"{v:.7g}" for v in vertices.ravel().tolist()))
    element.set("face", " ".join(map(str, faces.ravel().tolist())))
