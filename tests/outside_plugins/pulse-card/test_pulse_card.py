"""Tests of the view."""

from pulse_card import Pulse, Pulses


def test_notebooks_show_a_table_with_escaped_words():
    html = Pulses(Pulse(0.5, 12.25), Pulse(1.5, 3.0))._repr_html_()
    assert "Pulses &lt;of a load&gt;" in html
    assert "12.25" in html
    assert "2 pulses" in html
