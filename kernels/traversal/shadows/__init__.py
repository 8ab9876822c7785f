"""Traversals for shadow rays alone: towards a point light, and towards an area light; and the table of them.

They make their rays themselves, from points and a light, so they are no entries of `wrt.kernels.traversal.TRAVERSALS`. Their
answers are those of every traversal for the same rays, to the bit.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class ShadowTraversal:
    """A traversal for shadow rays.

    Attributes:
        name: key in `SHADOW_TRAVERSALS`.
        light: what it suits.
        entrance: the public class that uses it.
        paper: authors, title, year.
    """

    name: str
    light: str
    entrance: str
    paper: str


SHADOW_TRAVERSALS: dict[str, ShadowTraversal] = {
    traversal.name: traversal
    for traversal in (
        ShadowTraversal(
            "light_buffer",
            "a point light",
            "wrt.lights.LightBuffer",
            "Haines, Greenberg: The light buffer: a shadow-testing accelerator (1986)",
        ),
        ShadowTraversal(
            "multi_frusta",
            "an area light",
            "wrt.lights.AreaLightVisibility",
            "Benthin, Wald: Efficient ray traced soft shadows using multi-frusta tracing (2009)",
        ),
    )
}
"""Traversals for shadow rays by name."""
