"""The 40 classes of ModelNet40, and which of them the protocols leave out."""

from __future__ import annotations

# fmt: off
MODELNET40_CLASSES = (  # in the order of their labels, 0 to 39
    "airplane", "bathtub", "bed", "bench", "bookshelf", "bottle", "bowl", "car",
    "chair", "cone", "cup", "curtain", "desk", "door", "dresser", "flower_pot",
    "glass_box", "guitar", "keyboard", "lamp", "laptop", "mantel", "monitor", "night_stand",
    "person", "piano", "plant", "radio", "range_hood", "sink", "sofa", "stairs",
    "stool", "table", "tent", "toilet", "tv_stand", "vase", "wardrobe", "xbox",
)
# fmt: on
AXISYMMETRIC_CLASSES = frozenset(
    ("bottle", "bowl", "cone", "cup", "flower_pot", "lamp", "tent", "vase")
)
SEEN_CLASSES = frozenset(MODELNET40_CLASSES[:20])
