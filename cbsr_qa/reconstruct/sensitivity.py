"""Sensitivity of readings to the elements of an image, from fields on another mesh.

∂V_kl/∂γ over an image element is −∫∇u_k·∇u_l over it. The element is cut along the field's mesh, and the product is
taken at the centroid of each piece: exact for fields of the first order, of second order in the size of the pieces
for those of the second. To divide the integrals over the fields' own elements by area would be of first order, and
six times as far off at the sizes in use (a few thousand elements: 2.5 % of the Jacobian's norm against 0.4 %).
"""

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from cbsr_qa.domain.mesh import Mesh
from cbsr_qa.forward.model import ForwardModel
from cbsr_qa.reconstruct.overlap import Pieces, overlap_pieces

Array = NDArray[np.float64]
Indices = NDArray[np.int64]


def image_jacobian(model: ForwardModel, mesh: Mesh, drive: Indices, measure: Indices) -> Array:
    """Change of readings per change of the conductance of a mesh's elements.

    Parameters
    ----------
    model : its mesh covers the same sheet.
    mesh : of the image, e elements.
    drive, measure : (m,) numbers of the readings' drive and measure pairs.

    Returns
    -------
    (m, e) float64 [V/A per S].
    """
    pieces = overlap_pieces(model.mesh, mesh)
    fields = _fields_at(model, pieces)
    driven, measured = (fields @ pairs for pairs in (model.pattern.drive_currents(), model.pattern.measure_matrix()))
    driven, measured = (np.ascontiguousarray(each.transpose(2, 1, 0)) for each in (driven, measured))
    products = np.empty((len(drive), len(pieces.areas_mm2)))
    for row, one, other in zip(products, drive, measure, strict=True):
        np.einsum("xp,xp->p", driven[one], measured[other], out=row)
    count = len(pieces.areas_mm2)
    gather = sparse.csr_matrix((-pieces.areas_mm2, (pieces.coarse, np.arange(count))), (len(mesh.elements), count))
    return np.ascontiguousarray((gather @ products.T).T)


def _fields_at(model: ForwardModel, pieces: Pieces) -> Array:
    """Gradients of the electrodes' fields at the pieces' centroids, (p, 2, electrodes)."""
    elements, points = model.elements, model.elements.shapes.points
    nodal = model.electrode_fields[elements.cells]
    gradients = np.einsum("eqkx,ekl->eqxl", elements.gradients, nodal, optimize=True)
    if len(points) == 1:
        constant: Array = gradients[pieces.fine, 0]
        return constant
    corners = model.mesh.corners_mm[pieces.fine]
    along = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    inner = np.linalg.solve(along, (pieces.centroids_mm - corners[:, 0])[..., None])[..., 0]
    barycentric = np.column_stack([1 - inner.sum(axis=1), inner])
    weights = barycentric @ np.linalg.inv(points)  # the gradient is linear, and known at three points
    fields: Array = np.einsum("pq,pqxl->pxl", weights, gradients[pieces.fine], optimize=True)
    return fields
