"""The tangent matrix: assembled once, constrained for whatever is held, and remembered at the undeformed state."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import Any

import numpy as np
import scipy.sparse as sp
from dolfinx import fem, la
from dolfinx.fem import petsc as fp
from numpy.typing import NDArray
from petsc4py import PETSc

Array = NDArray[np.float64]
Index = NDArray[np.int32]


class Tangent:
    """Derivative of the residual, as a PETSc matrix in which rows and columns of held unknowns are those of the identity.

    This one is for one rank. DOLFINx assembles into its own blocked matrix, which takes less than half the time of
    PETSc's, and the values are copied into a PETSc matrix that shares its memory. The full matrix stays available: what
    is held can change, and prescribed displacements be lifted, without assembling again. At rest it is remembered.

    Args:
        forms: the compiled bilinear forms, which add up; the first has the sparsity of all.
        symmetric: whether the matrix is.

    Attributes:
        matrix: the constrained matrix.
    """

    def __init__(self, forms: Sequence[Any], symmetric: bool) -> None:
        self.forms = forms
        self.matrix = self._create()
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRIC, symmetric)
        # To stiffen it would otherwise end that, and CHOLMOD takes only what is known to be symmetric.
        self.matrix.setOption(PETSc.Mat.Option.SYMMETRY_ETERNAL, True)

    def _create(self) -> PETSc.Mat:
        """The PETSc matrix of the same pattern; `_order` tells where in the blocks each of its values stands."""
        self._remembered: dict[Hashable, Array] = {}
        self._full = full = fem.create_matrix(self.forms[0])
        size = full.block_size[0]
        blocks = full.data.reshape(-1, size, size)
        rows = size * (len(full.indptr) - 1)
        self._blocked = sp.bsr_matrix((blocks, full.indices, full.indptr), shape=(rows, rows))
        places = np.arange(1, full.data.size + 1, dtype=np.float64).reshape(blocks.shape)
        scalar = sp.bsr_matrix((places, full.indices, full.indptr), shape=(rows, rows)).tocsr()
        scalar.sort_indices()
        self._order = scalar.data.astype(np.int64) - 1
        self._columns = scalar.indices.astype(PETSc.IntType)
        self._rows = np.repeat(np.arange(rows, dtype=np.int32), np.diff(scalar.indptr))
        self._values = np.zeros(len(self._order))
        self._cleared: NDArray[np.intp] = np.zeros(0, dtype=np.intp)
        self._unit = self._cleared
        pointers = scalar.indptr.astype(PETSc.IntType)
        return PETSc.Mat().createAIJWithArrays(
            (rows, rows), (pointers, self._columns, self._values), comm=PETSc.COMM_SELF
        )

    def hold(self, held: Index, conditions: Sequence[Any]) -> None:
        """What is held from now on: unknowns of this rank, and the DOLFINx conditions that say the same."""
        fixed = np.zeros(self.matrix.getSize()[0], dtype=bool)
        fixed[held] = True
        self._cleared = np.flatnonzero(fixed[self._rows] | fixed[self._columns])
        self._unit = self._cleared[self._rows[self._cleared] == self._columns[self._cleared]]

    def assemble(self, key: Hashable = None) -> None:
        """The matrix at the present state; collective. With a `key`, a matrix remembered under it is taken instead."""
        remembered = self._remembered.get(key) if key is not None else None
        if remembered is not None:
            self._full.data[:] = remembered
        else:
            _fill(self._full, self.forms)
            if key is not None:
                self._remembered = {key: self._full.data.copy()}
        # All numbers are within: to look whether they are costs half of the time.
        np.take(self._full.data, self._order, out=self._values, mode="clip")
        self._values[self._cleared] = 0.0
        self._values[self._unit] = 1.0
        self.matrix.stateIncrease()

    def stiffen(self, part: float) -> None:
        """Add a part of the mean stiffness of an unknown to the diagonal, until it is assembled again; collective."""
        diagonal = self.matrix.getDiagonal()
        self.matrix.shift(part * diagonal.norm(PETSc.NormType.NORM_1) / diagonal.getSize())
        diagonal.destroy()

    def times(self, change: Array, transpose: bool = False) -> Array:
        """Product of the full matrix, as it was last assembled, or its transpose, with changes of all unknowns; one rank only."""
        return np.asarray((self._blocked.T if transpose else self._blocked) @ change)

    def times_in(self, rows: Index, change: Array, transpose: bool = False) -> Array:
        """The same in some rows."""
        if transpose and not self.matrix.isSymmetricKnown()[1]:
            return self.times(change, transpose)[rows]
        return self._some(rows) @ change

    def _some(self, rows: Index) -> sp.csr_matrix:
        """Rows of the full matrix."""
        size, start = self._blocked.blocksize[0], self._blocked.indptr
        blocks = np.unique(rows // size)
        counts = start[blocks + 1] - start[blocks]
        ends = np.cumsum(counts)
        taken = np.arange(counts.sum()) + np.repeat(start[blocks] - (ends - counts), counts)
        part = sp.bsr_matrix(
            (self._blocked.data[taken], self._blocked.indices[taken], np.concatenate([[0], ends])),
            shape=(size * len(blocks), self._blocked.shape[1]),
        )
        return part.tocsr()[size * np.searchsorted(blocks, rows // size) + rows % size]

    def copied(self) -> sp.csr_matrix:
        """The constrained matrix as it was last assembled, this rank's rows."""
        rows, columns, values = self.matrix.getValuesCSR()
        return sp.csr_matrix(
            (values.copy(), columns.copy(), rows.copy()), shape=(len(rows) - 1, self.matrix.getSize()[1])
        )

    def lifting(self, increment: Array, right: PETSc.Vec, state: PETSc.Vec) -> None:
        """Right-hand side for prescribed changes `increment` of the held unknowns (zero elsewhere, ghosts included); collective.

        With the matrix as it was last assembled.
        """
        right.array[:] = -(self._blocked @ increment)

    def destroy(self) -> None:
        """Free the PETSc matrix; collective."""
        self.matrix.destroy()


class LargeTangent(Tangent):
    """The same for large meshes: there is one copy of the matrix, which DOLFINx assembles and PETSc solves with.

    What the full matrix holds beyond it, the rows and columns of held unknowns, is few numbers that are kept aside.
    """

    def _create(self) -> PETSc.Mat:
        self._full = fem.create_matrix(self.forms[0], la.BlockMode.expanded)
        self._cleared = self._unit = np.zeros(0, dtype=np.intp)
        self._aside: Array = np.zeros(0)
        rows = len(self._full.indptr) - 1
        pointers, columns = (part.astype(PETSc.IntType, copy=False) for part in (self._full.indptr, self._full.indices))
        made = PETSc.Mat().createAIJWithArrays((rows, rows), (pointers, columns, self._full.data), comm=PETSc.COMM_SELF)
        made.setBlockSize(self.forms[0].function_spaces[0].dofmap.bs)
        return made

    def hold(self, held: Index, conditions: Sequence[Any]) -> None:
        """What is held from now on: unknowns of this rank, and the DOLFINx conditions that say the same."""
        fixed = np.zeros(len(self._full.indptr) - 1, dtype=bool)
        fixed[held] = True
        lengths = np.diff(self._full.indptr)
        self._cleared = np.flatnonzero(np.repeat(fixed, lengths) | fixed[self._full.indices])
        self._rows = np.searchsorted(self._full.indptr, self._cleared, side="right").astype(np.int32) - 1
        self._columns = self._full.indices[self._cleared]
        self._unit = self._cleared[self._rows == self._columns]
        self._aside = np.zeros(len(self._cleared))

    def assemble(self, _key: Hashable = None) -> None:
        """The matrix at the present state; none is remembered."""
        _fill(self._full, self.forms)
        self._aside = self._full.data[self._cleared]
        self._full.data[self._cleared] = 0.0
        self._full.data[self._unit] = 1.0
        # Smoothers keep the inverses of the blocks on the diagonal until the matrix is put together.
        self.matrix.assemble()

    def times(self, change: Array, transpose: bool = False) -> Array:
        """Product of the full matrix, as it was last assembled, or its transpose, with changes of all unknowns."""
        data, constrained = self._full.data, self._full.data[self._cleared]
        data[self._cleared] = self._aside
        full = sp.csr_matrix((data, self._full.indices, self._full.indptr), shape=self.matrix.getSize(), copy=False)
        product = np.asarray((full.T if transpose else full) @ change)
        data[self._cleared] = constrained
        return product

    def times_in(self, rows: Index, change: Array, transpose: bool = False) -> Array:
        """The same in some rows."""
        return self.times(change, transpose)[rows]

    def lifting(self, increment: Array, right: PETSc.Vec, _state: PETSc.Vec) -> None:
        """Right-hand side for prescribed changes `increment` of the held unknowns (zero elsewhere)."""
        lifted = self._aside * increment[self._columns]
        right.array[:] = -np.bincount(self._rows, lifted, minlength=len(right.array_r))


class SharedTangent(Tangent):
    """The same for a mesh that is shared out over several ranks: PETSc assembles."""

    def _create(self) -> PETSc.Mat:
        return fp.create_matrix(self.forms[0])

    def hold(self, _held: Index, conditions: Sequence[Any]) -> None:
        """What is held from now on: the DOLFINx conditions."""
        self._conditions = conditions

    def assemble(self, _key: Hashable = None) -> None:
        """The matrix at the present state; collective. None is remembered."""
        self.matrix.zeroEntries()
        # The diagonal of what is held is written, not added: last, by the form that comes first.
        for form in reversed(self.forms):
            fp.assemble_matrix(self.matrix, form, self._conditions, float(form is self.forms[0]))
            # PETSc does not add where values were just written, until they have been sent to where they belong.
            self.matrix.assemble(PETSc.Mat.AssemblyType.FLUSH)
        self.matrix.assemble()

    def lifting(self, increment: Array, right: PETSc.Vec, state: PETSc.Vec) -> None:
        """Right-hand side for prescribed changes `increment` of the held unknowns (zero elsewhere, ghosts included); collective.

        With the tangent at the present state, to which `state` belongs.
        """
        with right.localForm() as local:
            local.set(0.0)
        for form in self.forms:
            fp.apply_lifting(right, [form], [list(self._conditions)], [state], 1.0)
        right.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)


def _fill(matrix: Any, forms: Sequence[Any]) -> None:
    """Assemble the forms, which add up, into a matrix of DOLFINx."""
    matrix.data[:] = 0.0
    for form in forms:
        fem.assemble_matrix(matrix, form)
