"""Measure mimicry: the similarity of two sequences of loadings (Nagle section 5.1). Input and output are arrays."""

from morphspace.imitation.alignment import Alignment, align
from morphspace.imitation.chance import Baseline
from morphspace.imitation.comparison import Comparison, compare
from morphspace.imitation.part_of_face import masked_basis

__all__ = ["Alignment", "Baseline", "Comparison", "align", "compare", "masked_basis"]
