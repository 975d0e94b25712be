"""The linearisation of a form whose local unknowns are condensed: with its inverse."""

from collections.abc import Sequence

from ngsolve import BaseMatrix, BaseVector, BilinearForm, BitArray, SetHeapSize

from ngvisco.errors import StepError
from ngvisco.parallel.communicator import Communicator
from ngvisco.parallel.petsc import Direct

_UNITS = (
    "; a cell's own unknowns are eliminated without scaling: where moduli and volume/dt are twenty orders "
    "apart, as in SI in geodynamics, take units in which they are near one, or the split solver"
)


class CondensedJacobian:
    """The factorised linearisation of a condensed form; applies its inverse to full residuals."""

    def __init__(
        self,
        form: BilinearForm,
        inverse: str,
        heap_sizes: Sequence[int] = (),
        ranks: Communicator | None = None,
    ) -> None:
        """``heap_sizes`` are NGSolve's memory, bytes, tried for the matrix of a cell that its own is too
        small for.  On several ranks the inverse is that of PETSc's MUMPS."""
        self.form, self.inverse_type, self.heap_sizes = form, inverse, heap_sizes
        self.ranks = ranks or Communicator()
        self.free: BitArray = form.space.FreeDofs(True)
        self._inverse: BaseMatrix | None = None
        self._rhs: BaseVector | None = None

    @property
    def exists(self) -> bool:
        return self._inverse is not None

    def factorise(self, state: BaseVector) -> None:
        """Assemble and factorise at ``state``; raises StepError if the matrix is singular."""
        for work in (self._assemble, self._invert):
            failure = None
            try:
                work(state)
            except Exception as error:  # NGSolve raises NgException and std::exception alike
                failure = error
            together = self.ranks.agree(failure)
            if together is not None:
                self.forget()
                message = f"the linearised step has no factorisation: {str(together).strip()}"
                if "CalcLU" in message:  # of a cell, whose rows and columns NGSolve does not scale
                    message += _UNITS
                raise StepError(message) from together

    def _invert(self, state: BaseVector) -> None:
        if self._inverse is None:
            if self.ranks.is_distributed:
                self._inverse = Direct(self.form.mat, self.free, self.ranks)
            else:
                self._inverse = self.form.mat.Inverse(self.free, inverse=self.inverse_type)
            self._rhs = state.CreateVector()
        else:
            self._inverse.Update()

    def _assemble(self, state: BaseVector) -> None:
        for size in (*self.heap_sizes, None):
            try:
                self.form.AssembleLinearization(state)
                return
            except Exception as error:
                if size is None or "heap overflow" not in str(error).lower():
                    raise
                SetHeapSize(size)

    def forget(self) -> None:
        """Drop the factorisation, so that the next solve makes a new one; collective."""
        if isinstance(self._inverse, Direct):
            self._inverse.release()
        self._inverse = None

    def solve(self, residual: BaseVector, increment: BaseVector) -> None:
        """increment = Jacobian^{-1} residual, all blocks."""
        form, rhs = self.form, self._rhs
        assert rhs is not None and self._inverse is not None
        rhs.data = residual
        rhs.data += form.harmonic_extension_trans * residual
        increment.data = self._inverse * rhs
        increment.data += form.harmonic_extension * increment
        increment.data += form.inner_solve * rhs
