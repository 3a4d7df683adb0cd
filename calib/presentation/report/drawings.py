"""Drawings that explain names, in the same classes as the charts."""


def deviation_drawing() -> str:
    """Return what ``tx`` ... ``rz`` and ``offset`` of a joint mean, as one ``<svg>`` element."""
    parts = [
        # The link before, and the joint where the URDF has it and where it is.
        '<path class="line soft" stroke-width="7" d="M20 196L128 150"/>',
        '<text class="tick" x="14" y="222">link before it</text>',
        '<path class="level" d="M112 150v-42a18 7 0 0 1 36 0v42a18 7 0 0 1 -36 0z"/>',
        '<text class="tick" x="92" y="182">as in the URDF</text>',
        '<path class="line after" d="M172 132v-42a18 7 0 0 1 36 0v42a18 7 0 0 1 -36 0z"/>',
        '<text class="tick" x="166" y="162">as it is</text>',
        # How it was moved.
        '<path class="line before" d="M130 129L186 111m-9 -3l9 3l-6 8"/>',
        '<text class="label" x="98" y="94">tx, ty, tz</text>',
        # Its own axes: z along the axis, x and y across, and the turns about each.
        '<path class="line after" d="M190 88v-62m-4 8l4 -8l4 8"/>',
        '<text class="label" x="178" y="22">z: the axis</text>',
        '<path class="line after" d="M190 111L262 132m-9 2l9 -2l-6 -7"/>',
        '<text class="label" x="266" y="138">x</text>',
        '<path class="line after" d="M190 111L250 66m-9 1l9 -1l-3 8"/>',
        '<text class="label" x="254" y="64">y</text>',
        '<path class="line before" d="M236 137a6 12 0 1 0 -2 -22m8 -3l-8 3l6 6"/>',
        '<text class="label" x="228" y="154">rx</text>',
        '<path class="line before" d="M222 94a6 12 -40 1 1 13 -8m-4 -7l4 7l5 -6"/>',
        '<text class="label" x="232" y="106">ry</text>',
        '<path class="line before" d="M174 54a16 6 0 1 0 30 -4m-7 2l7 -2l2 7"/>',
        '<text class="label" x="108" y="54">rz, offset</text>',
    ]
    return f'<svg viewBox="0 0 300 232" width="300" height="232">{"".join(parts)}</svg>'


def deviation_words() -> str:
    """Return in words what the drawing shows."""
    return (
        "joint_2.tx, ty and tz: how far the joint is from where the URDF places it, along its own axes; rx, ry and rz: "
        "how far it is turned about them. z is the joint's axis. Where that is z of the joint's URDF frame, x and y "
        "are those of the frame; where it is x, they are its y and z; where it is y, its z and x. offset: what is "
        "added to the joint's position, about z or along it."
    )
