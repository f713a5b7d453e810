"""Assignment of least total cost, exactly: shortest augmenting paths.

The method of D. F. Crouse, On implementing 2D rectangular assignment algorithms, IEEE Trans. AES
2016, as scipy's `linear_sum_assignment`, which it is tested against.
"""

from __future__ import annotations

import numpy as np

from e3pose.base.arrays import Flags, Floats, Integers
from e3pose.base.kernel import kernel


@kernel
def assign(  # noqa: PLR0915
    costs: Floats,
    num_rows: int,
    num_columns: int,
    reals: Floats,
    integers: Integers,
    flags: Flags,
) -> None:
    """Write the column of each row of `costs` to `integers[0]`, -1 for none.

    `costs` holds at least `num_rows` by `num_columns` finite numbers; the smaller side is assigned
    completely. `reals` `(3, most)`, `integers` `(5, most)` and `flags` `(2, most)` are scratch, for
    `most` at least the number of rows and of columns.
    """
    turned = num_rows > num_columns
    few, many = (num_columns, num_rows) if turned else (num_rows, num_columns)
    few_prices, many_prices, lengths = reals[0], reals[1], reals[2]
    partner_of_few, partner_of_many = integers[1], integers[2]
    before, remaining = integers[3], integers[4]
    few_done, many_done = flags[0], flags[1]
    few_prices[:few] = 0.0
    many_prices[:many] = 0.0
    partner_of_few[:few] = -1
    partner_of_many[:many] = -1
    for start in range(few):
        for index in range(many):
            remaining[index] = many - 1 - index
            lengths[index] = np.inf
            many_done[index] = False
        few_done[:few] = False
        left = many
        shortest = 0.0
        row, end = start, -1
        while end < 0:
            few_done[row] = True
            least = np.inf
            place = -1
            for index in range(left):
                column = remaining[index]
                cost = costs[column, row] if turned else costs[row, column]
                length = shortest + cost - few_prices[row] - many_prices[column]
                if length < lengths[column]:
                    lengths[column] = length
                    before[column] = row
                # Of equally near columns a free one ends the search.
                if lengths[column] < least or (
                    lengths[column] == least and partner_of_many[column] < 0
                ):
                    least = lengths[column]
                    place = index
            shortest = least
            column = remaining[place]
            many_done[column] = True
            left -= 1
            remaining[place] = remaining[left]
            if partner_of_many[column] < 0:
                end = column
            else:
                row = partner_of_many[column]
        few_prices[start] += shortest
        for row in range(few):
            if few_done[row] and row != start:
                few_prices[row] += shortest - lengths[partner_of_few[row]]
        for column in range(many):
            if many_done[column]:
                many_prices[column] -= shortest - lengths[column]
        column = end
        while True:
            row = before[column]
            partner_of_many[column] = row
            partner_of_few[row], column = column, partner_of_few[row]
            if row == start:
                break
    chosen = integers[0]
    for row in range(num_rows):
        chosen[row] = partner_of_many[row] if turned else partner_of_few[row]
