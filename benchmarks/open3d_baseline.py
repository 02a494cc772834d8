"""The bar: Open3D's FPFH + RANSAC + point-to-plane ICP on the same pairs.

    python benchmarks/open3d_baseline.py modelnet --data DIR
    python benchmarks/open3d_baseline.py real_scans --data DIR [--voxel 0.05]

Settings: clouds centered and scaled to unit radius, normals from 30 neighbors towards the centroid,
FPFH radius 0.3 with at most 100 neighbors, mutual matches, RANSAC with 100,000 rounds at most,
distance 0.05, edge ratio 0.9, confidence 0.999, then ICP at 0.05 with 30 rounds. Real scans may be
thinned by a voxel grid for the global step; ICP then runs on the thinned clouds, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import modelnet
import real_scans
from common import Answer, argument_parser, data_folder
from fullturn.data.motion import rigid
from fullturn.data.pair import Pair
from fullturn.evaluation.metrics import radius

DISTANCE = 0.05
FEATURE_RADIUS = 0.3
NEIGHBORS = 30
FEATURE_NEIGHBORS = 100
RANSAC_ROUNDS = 100_000
ICP_ROUNDS = 30


@dataclass(frozen=True)
class Open3dRegistrar:
    """FPFH, RANSAC and ICP; a class, so that it can be sent to another process."""

    voxel: float = 0.0  # in radii; 0: the clouds as they are

    def __call__(self, pair: Pair, seed: int) -> Answer:
        import open3d as o3d

        pipeline = o3d.pipelines.registration
        o3d.utility.random.seed(seed)
        o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
        length = max(radius(pair.source), radius(pair.target))
        clouds, features, centers = [], [], []
        for points in (pair.source, pair.target):
            center = points.mean(axis=0)
            cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector((points - center) / length))
            if self.voxel > 0.0:
                cloud = cloud.voxel_down_sample(self.voxel)
            cloud.estimate_normals(o3d.geometry.KDTreeSearchParamKNN(NEIGHBORS))
            cloud.orient_normals_towards_camera_location(cloud.get_center())
            features.append(
                pipeline.compute_fpfh_feature(
                    cloud,
                    o3d.geometry.KDTreeSearchParamHybrid(FEATURE_RADIUS, FEATURE_NEIGHBORS),
                )
            )
            clouds.append(cloud)
            centers.append(center)
        coarse = pipeline.registration_ransac_based_on_feature_matching(
            clouds[0],
            clouds[1],
            features[0],
            features[1],
            True,
            DISTANCE,
            pipeline.TransformationEstimationPointToPoint(False),
            3,
            [
                pipeline.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                pipeline.CorrespondenceCheckerBasedOnDistance(DISTANCE),
            ],
            pipeline.RANSACConvergenceCriteria(RANSAC_ROUNDS, 0.999),
        )
        fine = pipeline.registration_icp(
            clouds[0],
            clouds[1],
            DISTANCE,
            coarse.transformation,
            pipeline.TransformationEstimationPointToPlane(),
            pipeline.ICPConvergenceCriteria(max_iteration=ICP_ROUNDS),
        )
        rotation, shift = fine.transformation[:3, :3], fine.transformation[:3, 3]
        return Answer(rigid(rotation, length * shift + centers[1] - rotation @ centers[0]))


def main() -> None:
    """Run one of the two benchmarks with Open3D."""
    parser = argument_parser(__doc__.splitlines()[0], count=300, name="")
    parser.add_argument("benchmark", choices=("modelnet", "real_scans"))
    parser.add_argument("--voxel", type=float, default=0.0, help="grid size in radii; 0: none")
    modelnet.add_arguments(parser)
    arguments = parser.parse_args()
    arguments.name = arguments.name or f"open3d_{arguments.benchmark}"
    label = "Open3D FPFH + RANSAC 100k + ICP" + (
        f", voxel {arguments.voxel:g}" if arguments.voxel else ""
    )
    bench = {"modelnet": modelnet, "real_scans": real_scans}[arguments.benchmark]
    bench.run(Open3dRegistrar(arguments.voxel), label, arguments, data_folder(parser, arguments))


if __name__ == "__main__":
    main()
