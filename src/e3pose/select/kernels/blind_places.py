"""Detection rate by place: where a camera seldom detects people, as behind walls and shelves.

A rig's geometry says which places lie inside an image, but not what stands between. The estimator
counts which of a camera's looks at people who were there showed them, by place
(`filter.blindness`), and keeps that longer than any track: somebody new, or somebody who comes
round a corner, is not expected of a camera that showed nobody there before.
"""

from __future__ import annotations

from e3pose.base.kernel import kernel

# A view in plain sight knows a joint to about 2 cm, an unseen one may be off by 20 cm: a view adds
# 100 times the information there was.
# tuned: ratio | by reasoning: 20 cm over 2 cm, squared | not measured
INFORMATION_RATIO = 100.0


@kernel
def worth(shows: float) -> float:
    """Return the value of a camera, as a share, from its probability to show a person.

    A camera that shows somebody with probability p and otherwise nothing is worth p log(1 + W) nats
    where one that always shows W times what is known is worth log(1 + W): as much as one that
    always shows ((1 + W)^p - 1) / W of that.
    """
    return float(((1.0 + INFORMATION_RATIO) ** shows - 1.0) / INFORMATION_RATIO)
