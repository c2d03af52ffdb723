#pragma once
// Triangle meshes of ranges over a sphere.

#include "daemon/files/mesh_files.h"

namespace celadon {

/// The surface and, on each end that is no pole, a fan from the middle of its rim. Rows of constant w, columns of
/// constant theta, poles as fans; every triangle has been compared with the surface along rays through the middles of
/// its edges and its own.
/// @pre as mesh_of; the base is a sphere
TriangleMesh sphere_mesh(const RangeFunction& range, double chord_mm);

}  // namespace celadon
