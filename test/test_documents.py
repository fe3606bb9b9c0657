"""The documents name what is there: links, pictures, programs and targets of make."""

from pathlib import Path
import re

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob('*.md'), *(ROOT / 'docs').glob('*.md')])


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_links_and_pictures_are_there(page):
    links = re.findall(r'\]\(([^)#\s]+)', page.read_text())
    missing = [link for link in links if '://' not in link and not (page.parent / link).exists()]
    assert not missing


def test_every_picture_is_shown_or_linked():
    text = ''.join(page.read_text() for page in PAGES)
    pictures = {path.name for path in (ROOT / 'docs' / 'images').iterdir()}
    narrow = {name for name in pictures if name.endswith('_390.png')}  # beside the wide ones
    assert pictures and all(name in text for name in pictures - narrow)


def test_the_readme_names_every_program():
    readme, setup = (ROOT / 'README.md').read_text(), (ROOT / 'setup.py').read_text()
    nodes = re.findall(r"'(\w+)'", re.search(r'NODES = \((.*?)\)', setup, re.DOTALL).group(1))
    programs = re.findall(r"'(\w+)':", re.search(r'PROGRAMS = \{(.*?)\}', setup,
                                                 re.DOTALL).group(1))
    assert len(nodes) > 5 and len(programs) > 3
    assert not [name for name in nodes + programs if f'`{name}`' not in readme]


@pytest.mark.parametrize('page', PAGES, ids=lambda page: page.name)
def test_targets_of_make_exist(page):
    targets = set(re.findall(r'^([a-z-]+):', (ROOT / 'Makefile').read_text(), re.MULTILINE))
    named = set(re.findall(r'(?:`|^)make ([a-z-]+)', page.read_text(), re.MULTILINE))
    assert named <= targets
