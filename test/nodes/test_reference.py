"""The reference page says what the code says."""

from pathlib import Path

from homography_servo.nodes.reference import reference_text

PAGE = Path(__file__).resolve().parents[2] / 'docs' / 'reference.md'


def test_the_page_is_what_the_code_says(monkeypatch, domain):
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'LOCALHOST')
    monkeypatch.setenv('ROS_DOMAIN_ID', str(domain))
    assert PAGE.read_text() == reference_text(), \
        'run: python -m homography_servo.nodes.reference > docs/reference.md'
