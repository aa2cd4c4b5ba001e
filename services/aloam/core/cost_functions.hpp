#pragma once
// The residuals of A-LOAM for Ceres, with automatic derivatives. The motion is a unit quaternion
// (x y z w) and a translation: p_target = q p + t.
//
//   line    r = ((p - a) x (p - b)) / |a - b|     (three values)
//   plane   r = (p - j) . n, n the normal of the triangle j l m
//   normal  r = n . p + d
//
// `share` is the share of the motion that a point has seen: 1 where the sweep is taken as rigid.
// The motion of a share is slerp(identity, q, share) and share t.

#include <ceres/ceres.h>

#include <Eigen/Geometry>

namespace zloam::aloam {

template <typename T>
Eigen::Matrix<T, 3, 1> moved_by(const T* q, const T* t, const Eigen::Vector3d& point,
                                double share) {
  Eigen::Quaternion<T> rotation(q[3], q[0], q[1], q[2]);
  Eigen::Matrix<T, 3, 1> shift(t[0], t[1], t[2]);
  if (share != 1.0) {
    rotation = Eigen::Quaternion<T>::Identity().slerp(T(share), rotation);
    shift *= T(share);
  }
  return rotation * point.cast<T>() + shift;
}

class LineCost {
 public:
  static ceres::CostFunction* create(const Eigen::Vector3d& point, const Eigen::Vector3d& a,
                                     const Eigen::Vector3d& b, double share) {
    return new ceres::AutoDiffCostFunction<LineCost, 3, 4, 3>(new LineCost(point, a, b, share));
  }
  LineCost(const Eigen::Vector3d& point, const Eigen::Vector3d& a, const Eigen::Vector3d& b,
           double share)
      : point_(point), a_(a), b_(b), share_(share) {}

  template <typename T>
  bool operator()(const T* q, const T* t, T* residual) const {
    const Eigen::Matrix<T, 3, 1> p = moved_by(q, t, point_, share_);
    const Eigen::Matrix<T, 3, 1> area = (p - a_.cast<T>()).cross(p - b_.cast<T>());
    const T length = T((a_ - b_).norm());
    for (int i = 0; i < 3; ++i) residual[i] = area[i] / length;
    return true;
  }

 private:
  Eigen::Vector3d point_, a_, b_;
  double share_;
};

class PlaneCost {
 public:
  static ceres::CostFunction* create(const Eigen::Vector3d& point, const Eigen::Vector3d& j,
                                     const Eigen::Vector3d& l, const Eigen::Vector3d& m,
                                     double share) {
    return new ceres::AutoDiffCostFunction<PlaneCost, 1, 4, 3>(
        new PlaneCost(point, j, (j - l).cross(j - m).normalized(), share));
  }
  PlaneCost(const Eigen::Vector3d& point, const Eigen::Vector3d& on_plane,
            const Eigen::Vector3d& normal, double share)
      : point_(point), on_plane_(on_plane), normal_(normal), share_(share) {}

  template <typename T>
  bool operator()(const T* q, const T* t, T* residual) const {
    const Eigen::Matrix<T, 3, 1> p = moved_by(q, t, point_, share_);
    residual[0] = (p - on_plane_.cast<T>()).dot(normal_.cast<T>());
    return true;
  }

 private:
  Eigen::Vector3d point_, on_plane_, normal_;
  double share_;
};

class NormalCost {
 public:
  static ceres::CostFunction* create(const Eigen::Vector3d& point, const Eigen::Vector3d& normal,
                                     double offset) {
    return new ceres::AutoDiffCostFunction<NormalCost, 1, 4, 3>(
        new NormalCost(point, normal, offset));
  }
  NormalCost(const Eigen::Vector3d& point, const Eigen::Vector3d& normal, double offset)
      : point_(point), normal_(normal), offset_(offset) {}

  template <typename T>
  bool operator()(const T* q, const T* t, T* residual) const {
    residual[0] = normal_.cast<T>().dot(moved_by(q, t, point_, 1.0)) + T(offset_);
    return true;
  }

 private:
  Eigen::Vector3d point_, normal_;
  double offset_;
};

}  // namespace zloam::aloam
