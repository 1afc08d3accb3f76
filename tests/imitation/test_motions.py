"""The motions of an imitation: their names."""

from pathlib import Path

from morphspace.imitation.motions import _name_of_table


def test_a_motion_is_called_what_people_call_it():
    """A file that a verb named is called after its folder, any other after itself."""
    assert _name_of_table(Path("anna_to_ben/loadings.csv"), {}) == "anna_to_ben"
    assert _name_of_table(Path("anna/smile.csv"), {"identity": "ben"}) == "smile"
    assert _name_of_table(Path("loadings.csv"), {}) == Path.cwd().name
    named = {"identity": "ben", "source_identity": "anna"}
    assert _name_of_table(Path("/loadings.csv"), named) == "anna"
    assert _name_of_table(Path("/stimulus.csv"), {"identity": "ben"}) == "ben"
    assert _name_of_table(Path("/stimulus.csv"), {}) == "stimulus"
