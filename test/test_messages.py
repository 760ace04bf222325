# Copyright 2026 The pendubot_identification authors
# SPDX-License-Identifier: Apache-2.0

"""Every error message ends with an instruction."""

import ast
import re
import typing

from pendubot_identification import errors
from test.conftest import ROOT

#: LongRecordingError adds the remedy itself.
ERRORS = {*vars(errors), 'RefusedError'} - {'LongRecordingError'}
#: Subpackages whose errors are mostly reasons why a program waits or stops.
REASONS = 'control', 'tracking'
VERBS = (
    'add allow begin call check choose convert copy correct design end export free give identify install leave load '
    'look name record remove rename see set source stop take track try use widen write'
)
#: An option, an expectation, the choices, a question, another message, or one or more instructions.
REMEDY = re.compile(
    r'--[a-z]|pip install|in MATLAB,|\bexpected\b|^(the|its) \S+ are|\?$|: {}$|^{}$'
    rf'|(^|: |, |\bor )({VERBS.replace(" ", "|")})\b'
)


def text_of(node: ast.expr, known: typing.Mapping[str, ast.expr]) -> str:
    """Return a text in the code with {} for variable parts, and the second case of a conditional text."""
    if isinstance(node, ast.Constant):
        return str(node.value)
    if isinstance(node, ast.JoinedStr):
        return ''.join(text_of(part, known) for part in node.values)
    if isinstance(node, ast.BinOp):
        return text_of(node.left, known) + text_of(node.right, known)
    if isinstance(node, ast.IfExp):
        return text_of(node.orelse, known)
    if isinstance(node, ast.FormattedValue) and isinstance(node.value, (ast.IfExp, ast.Name)):
        return text_of(node.value, known)
    return text_of(known[node.id], {}) if isinstance(node, ast.Name) and node.id in known else '{}'


def messages():
    """Yield the location and the text of each error in the code."""
    for path in sorted((ROOT / 'pendubot_identification').rglob('*.py')):
        if path.parent.name in REASONS:
            continue
        module = ast.parse(path.read_text())
        for function in (node for node in ast.walk(module) if isinstance(node, ast.FunctionDef)):
            assigned = [each for each in (*module.body, *ast.walk(function)) if isinstance(each, ast.Assign)]
            known = {ast.unparse(each.targets[0]): each.value for each in assigned}
            for call in ast.walk(function):
                if isinstance(call, ast.Call) and ast.unparse(call.func) in ERRORS and call.args:
                    yield f'{path.name}:{call.lineno}', text_of(call.args[0], known)


def test_every_error_message_ends_with_an_instruction_or_an_expectation():
    errors_found = list(messages())
    assert len(errors_found) > 150
    assert not [(place, text) for place, text in errors_found if not REMEDY.search(re.split(r'; |\? ', text)[-1])]
