# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every error message ends with an instruction."""

import ast
import re

from pendubot_identification import errors
from test.conftest import ROOT

ERRORS = {*vars(errors), 'RefusedError'}
#: Subpackages whose errors are mostly reasons why a program waits or stops.
REASONS = 'control', 'tracking'
VERBS = (
    'add allow begin call check choose convert copy correct design end export free give identify install leave load '
    'look name record remove rename see set source stop take track try use widen write'
)
#: An option, an expectation, the choices, a question, another message, or one or more instructions.
REMEDY = re.compile(
    r'--[a-z]|pip install|in MATLAB,|\bexpected\b|^(the|its) \S+ are|\?$|: {}$|^{}(, unchanged)?$|or {}$'
    rf'|(^|: |, |\bor )({VERBS.replace(" ", "|")})\b'
)


def text_of(node: ast.expr) -> str:
    """Return a text in the code with {} for variable parts, and the second case of a conditional text."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return ''.join(map(text_of, node.values))
    if isinstance(node, ast.BinOp):
        return text_of(node.left) + text_of(node.right)
    return text_of(node.orelse) if isinstance(node, ast.IfExp) else '{}'


def test_every_error_message_ends_with_an_instruction_or_an_expectation():
    messages = {}
    for path in (ROOT / 'pendubot_identification').rglob('*.py'):
        for call in ast.walk(ast.parse(path.read_text())) if path.parent.name not in REASONS else ():
            if isinstance(call, ast.Call) and ast.unparse(call.func) in ERRORS and call.args:
                messages[f'{path.name}:{call.lineno}'] = text_of(call.args[0])
    assert len(messages) > 150
    lacking = {place: text for place, text in messages.items() if not REMEDY.search(re.split(r'; |\? ', text)[-1])}
    assert not lacking
