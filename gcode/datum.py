"""Treatment of blocks (program lines) whose axis words are not plain moves.

They are blocks with G92, G28, G30 or G43.1, and moves from an unknown position.
"""

from __future__ import annotations

import math

from gcode.codes import AXIS_LETTERS
from gcode.modal import UNKNOWN, ModalState
from gcode.polar import POLAR, polar_end, require_polar_plane
from gcode.setup import NO_OFFSET, SYSTEMS, Triple
from gcode.words import Block
from gcode.writer import ProgramWriter

_BLENDING = 640
_NO_POSITION = "its position at that point is not known"


def axes_in_block(block: Block) -> list[int]:
    """Return the indices of the axes that have a word in the block."""
    return [axis for axis, letter in enumerate(AXIS_LETTERS) if letter in block.values]


def program_zero(block: Block, modal: ModalState) -> Triple:
    """Return the axis position in mm of the program's zero point.

    Raises FormatError if the work offset in effect is not known.
    """
    if modal.offset is None:
        name = modal.system
        block.refuse(f"the work offset {name} is not known", f"Give it: --work-offset {name}=X,Y,Z")
    return modal.offset


def target_position(block: Block, modal: ModalState, machine: bool) -> Triple:
    """Return the programmed axis position in mm after the block. An axis without a word in the block keeps its
    programmed position. If `machine` is True, the axis words are machine coordinates.
    """
    values, unit, position = block.values, modal.unit_mm, modal.position
    if machine:
        base: Triple | list[float] = NO_OFFSET
    else:
        base = program_zero(block, modal) if modal.absolute else position
    if not POLAR.isdisjoint(values):
        return _polar_target(block, modal, machine)
    x, y, z = values.get("X"), values.get("Y"), values.get("Z")
    return (
        position[0] if x is None else x * unit + base[0],
        position[1] if y is None else y * unit + base[1],
        position[2] if z is None else z * unit + base[2],
    )


def _polar_target(block: Block, modal: ModalState, machine: bool) -> Triple:
    values, unit, position = block.values, modal.unit_mm, modal.position
    if machine:
        block.refuse("polar coordinates count from the zero point of the program, so G53 cannot use them")
    require_polar_plane(values, modal.plane, block.source)
    zero = program_zero(block, modal)
    if not modal.position_known:
        block.refuse("the position of the axes at this line is not known", modal.start_hint)
    x, y = ((position[axis] - zero[axis]) / unit for axis in (0, 1))
    end_x, end_y = polar_end(x, y, values.get("@"), values.get("^"), absolute=modal.absolute, source=block.source)
    z = values.get("Z")
    end_z = position[2] if z is None else z * unit + (zero if modal.absolute else position)[2]
    return end_x * unit + zero[0], end_y * unit + zero[1], end_z


def set_datum(block: Block, code: int, modal: ModalState, writer: ProgramWriter) -> None:
    """Execute G92 and its variants G92.1, G92.2 and G92.3.

    G92 assigns the given coordinates to the present position. The controller is actually at the corrected position, so
    the correction is added to the coordinates that are written to the corrected program. The offset in the controller
    is then the offset that the program intends, except for the rounding of the written coordinates.
    """
    writer.flush()
    if code == 920:
        _set_zero(block, modal, writer)
    elif code == 923:
        if modal.g92_saved is None:
            block.refuse("the G92 offset to be restored was not set in this program")
        modal.g92, modal.g92_written = modal.g92_saved
        writer.write_unchanged(block.text)
    else:
        # G92.1 deletes the offset. G92.2 only suspends it; it stays saved for G92.3 until it is set again.
        modal.g92_saved = (modal.g92_saved or (modal.g92, modal.g92_written)) if code == 922 else None
        modal.g92 = modal.g92_written = NO_OFFSET
        writer.write_unchanged(block.text)
    modal.update_frame()


def _set_zero(block: Block, modal: ModalState, writer: ProgramWriter) -> None:
    axes = axes_in_block(block)
    if not axes:
        block.refuse("G92 needs an axis word")
    origin = program_zero(block, modal)
    intended, written, texts = list(modal.g92), list(modal.g92_written), {}
    for axis in axes:
        if math.isnan(modal.position[axis]):
            block.refuse(f"G92 sets coordinates of {AXIS_LETTERS[axis]}, but {_NO_POSITION}", modal.start_hint)
        value_mm = block.values[AXIS_LETTERS[axis]] * modal.unit_mm
        difference = writer.position[axis] - modal.position[axis]
        texts[axis] = f"{(value_mm + difference) / modal.unit_mm:.{writer.decimals}f}"
        # Position = coordinate + G92 offset + (work offset + tool length), solved for the G92 offset: with the
        # programmed position and coordinate for what the program intends, with the real position and the rounded number
        # for what the controller stores.
        without = origin[axis] - modal.g92[axis]
        intended[axis] = modal.position[axis] - value_mm - without
        written[axis] = writer.position[axis] - float(texts[axis]) * modal.unit_mm - without
    modal.g92, modal.g92_written = _triple(intended), _triple(written)
    modal.g92_saved = (modal.g92, modal.g92_written)
    writer.write_unchanged(replace_axis_words(block, texts))


def go_to_reference(block: Block, name: str, modal: ModalState, writer: ProgramWriter) -> None:
    """Execute G28 or G30. The axes move through a corrected intermediate point to the reference point stored in the
    controller.

    The reference point is not corrected. Only the axes with a word in the block move. If the block has no axis words,
    all axes move.
    """
    writer.flush()
    axes = axes_in_block(block)
    through = target_position(block, modal, machine=False) if axes else _triple(modal.position)
    if axes and not any(map(math.isnan, (*through, *modal.position))):
        point = writer.corrected_point(through, block)
        writer.write_unchanged(replace_axis_words(block, _through_words(axes, point, modal, writer)))
    else:
        writer.write_unchanged(block.text)
    intended, stored = modal.references.get(name, (UNKNOWN, UNKNOWN))
    # G30 P3 and P4 are further reference points of some controllers; where they are is not known.
    if block.values.get("P", 2.0) != 2.0 and _BLENDING not in block.g:
        intended = stored = UNKNOWN
    for axis in axes or range(3):
        modal.position[axis], writer.position[axis] = intended[axis], stored[axis]
    writer.resume_at(_triple(modal.position), writer.position, modal.unit_mm)


def store_reference(block: Block, name: str, modal: ModalState, writer: ProgramWriter) -> None:
    """Execute G28.1 or G30.1, which store the present position as the reference point of G28 or G30.

    The controller stores the corrected position.
    """
    if axes_in_block(block):
        block.refuse("this G code takes no axis words")
    writer.flush()
    modal.references[name] = (_triple(modal.position), _triple(writer.position))
    writer.write_unchanged(block.text)


def set_work_offset(block: Block, modal: ModalState, writer: ProgramWriter) -> None:
    """Execute G10 L2, which sets a work offset, or G10 L20, which sets the work offset so that the present position
    gets the given coordinates.

    With L20, the correction at the present position is added to the coordinates that are written, as with G92.
    """
    kind, number = block.values.get("L"), block.values.get("P")
    if kind not in (2.0, 20.0) or block.values.get("R", 0.0) != 0.0:
        message = "only work offsets without rotation can be set (G10 L2, G10 L20)"
        block.refuse(message, "Set the other offsets before the program and give them to this command")
    if number is None or not (number.is_integer() and 0.0 <= number <= len(SYSTEMS)):
        block.refuse(f"G10 needs the number of the work offset, P0 to P{len(SYSTEMS)}")
    if kind == 2.0 and not modal.absolute:
        message = "G10 L2 with G91 adds to the offset on some controllers and replaces it on others"
        block.refuse(message, "Write it with G90")
    writer.flush()
    # P0 is the coordinate system in effect.
    name = SYSTEMS[int(number) - 1] if number else modal.system
    intended = list(modal.work_offsets.get(name, UNKNOWN))
    written = list(modal.work_written.get(name, UNKNOWN))
    texts = {}
    for axis in axes_in_block(block):
        value_mm = block.values[AXIS_LETTERS[axis]] * modal.unit_mm
        if kind == 2.0:
            intended[axis] = written[axis] = value_mm
            continue
        if math.isnan(modal.position[axis]):
            block.refuse(f"G10 L20 sets coordinates of {AXIS_LETTERS[axis]}, but {_NO_POSITION}", modal.start_hint)
        difference = writer.position[axis] - modal.position[axis]
        texts[axis] = f"{(value_mm + difference) / modal.unit_mm:.{writer.decimals}f}"
        # Position = coordinate + work offset + G92 offset + tool length, solved for the work offset, twice as in
        # `_set_zero`.
        intended[axis] = modal.position[axis] - value_mm - modal.g92[axis] - modal.tool_offset[axis]
        told_mm = float(texts[axis]) * modal.unit_mm
        written[axis] = writer.position[axis] - told_mm - modal.g92_written[axis] - modal.tool_offset[axis]
    if any(map(math.isnan, intended)):
        block.refuse(f"the work offset {name} is not known", f"Give it: --work-offset {name}=X,Y,Z")
    modal.work_offsets[name], modal.work_written[name] = _triple(intended), _triple(written)
    writer.write_unchanged(replace_axis_words(block, texts) if texts else block.text)
    modal.update_frame()


def _through_words(axes: list[int], point: Triple, modal: ModalState, writer: ProgramWriter) -> dict[int, str]:
    base = modal.frame[:3] if modal.absolute else writer.position
    # Adding 0.0 turns -0.0 into 0.0, which would be written with its sign.
    return {axis: f"{(point[axis] - base[axis]) / modal.unit_mm + 0.0:.{writer.decimals}f}" for axis in axes}


def set_tool_length(block: Block, modal: ModalState) -> None:
    """Execute G43.1. Its axis words give the tool lengths."""
    lengths = list(modal.tool_offset)
    for axis in axes_in_block(block):
        lengths[axis] = block.values[AXIS_LETTERS[axis]] * modal.unit_mm
    modal.tool_offset = _triple(lengths)


def move_from_unknown_position(
    block: Block, end: Triple, machine: bool, modal: ModalState, writer: ProgramWriter
) -> None:
    """Write a rapid move unchanged. It cannot be corrected, because the position of at least one axis is unknown even
    after the move.

    The new positions of the axes named in the block are recorded in `modal` and `writer`.
    """
    writer.flush()
    frame = (*NO_OFFSET, True) if machine else modal.frame
    for axis in axes_in_block(block):
        # An incremental word from an unknown position adds to NaN: the axis stays unknown.
        word_mm = block.values[AXIS_LETTERS[axis]] * modal.unit_mm
        writer.position[axis] = word_mm + (frame[axis] if frame[3] else writer.position[axis])
    modal.position = list(end)
    writer.write_unchanged(block.text)
    writer.counts.not_corrected += 1
    writer.resume_at(_triple(modal.position), writer.position, modal.unit_mm)


def forget_position(modal: ModalState, writer: ProgramWriter) -> None:
    """Mark the positions of all axes as unknown, as required after a tool change."""
    writer.flush()
    modal.position = [math.nan] * 3
    writer.resume_at(_triple(modal.position), [math.nan] * 3, modal.unit_mm)


def replace_axis_words(block: Block, texts: dict[int, str]) -> str:
    """Return the text of the block with new numbers in its axis words."""
    words = []
    for letter, number, _ in block.tokens:
        axis = AXIS_LETTERS.find(letter)
        words.append(letter + texts.get(axis, number))
    return " ".join([*words, block.comments] if block.comments else words)


def _triple(values: list[float] | Triple) -> Triple:
    x, y, z = values
    return x, y, z
