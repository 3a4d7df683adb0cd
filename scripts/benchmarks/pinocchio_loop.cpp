// The yardstick in C++: what one residual and its Jacobian cost with Pinocchio's own functions and nothing else.
// Built and called by yardsticks.py.

#include <Eigen/Core>
#include <pinocchio/algorithm/frames.hpp>
#include <pinocchio/algorithm/kinematics.hpp>
#include <pinocchio/algorithm/regressor.hpp>
#include <pinocchio/multibody.hpp>
#include <pinocchio/spatial.hpp>

using namespace pinocchio;
using Matrix = Eigen::Matrix<double, Eigen::Dynamic, Eigen::Dynamic, Eigen::RowMajor>;
using Regressor = Eigen::Matrix<double, 6, Eigen::Dynamic>;
using Placement = Eigen::Matrix<double, 4, 4, Eigen::RowMajor>;

namespace {

struct Robot {
  Model model;
  Data data;
  FrameIndex tip;
  Regressor regressor;  // (6, 6 nj)

  Robot(const Model& m, FrameIndex frame)
      : model(m), data(m), tip(frame), regressor(Regressor::Zero(6, 6 * (m.njoints - 1))) {}

  const SE3& place(const double* q) {
    forwardKinematics(model, data, Eigen::Map<const Eigen::VectorXd>(q, model.nq));
    updateFramePlacement(model, data, tip);
    computeFrameKinematicRegressor(model, data, tip, LOCAL, regressor);
    return data.oMf[tip];
  }
};

SE3 placement(const double* T) { return SE3(Eigen::Map<const Placement>(T)); }

}  // namespace

extern "C" {

// A chain of n joints that turn about their z; placements (n, 4, 4), and the tip's behind the last joint.
void* make(int n, const double* placements, const double* tip) {
  Model model;
  JointIndex parent = 0;
  for (int i = 0; i < n; ++i)
    parent = model.addJoint(parent, JointModelRZ(), placement(placements + 16 * i), "joint_" + std::to_string(i));
  const FrameIndex frame = model.addFrame(Frame("tip", parent, 0, placement(tip), OP_FRAME));
  return new Robot(model, frame);
}

void drop(void* robot) { delete static_cast<Robot*>(robot); }

// Kinematics alone, nothing kept but a sum, so that nothing is left out.
double kinematics(void* handle, int rows, const double* q) {
  Robot& robot = *static_cast<Robot*>(handle);
  double sum = 0.0;
  for (int n = 0; n < rows; ++n) sum += robot.place(q + n * robot.model.nq).translation()[0] + robot.regressor(0, 0);
  return sum;
}

// How the twists of the joints' placements, and last of the tool, follow the parameters: entries (row, column, share) of
// a matrix (6 nj + 6, p) that is nearly empty; `at` (entries, 2).
// Residuals (rows, d) and Jacobians (rows, d, p): d is 3 for positions, and 6 for poses, which have rotations (rows, 3, 3).
void residual_and_jacobian(void* handle, int rows, int d, int p, const double* q, const double* base_, const double* tool_,
                           const double* positions, const double* rotations, int n_entries, const int* at,
                           const double* shares, double* residuals, double* jacobians) {
  using Rotation = Eigen::Matrix<double, 3, 3, Eigen::RowMajor>;
  using Six = Eigen::Matrix<double, 6, 6>;
  Robot& robot = *static_cast<Robot*>(handle);
  const SE3 base = placement(base_), tool = placement(tool_);
  const int joints = robot.model.njoints - 1;
  const Six to_tool = tool.toActionMatrixInverse();
  Six by_twist = Six::Zero();
  // One row a twist, so that an entry moves a column of d numbers at once.
  Regressor by_joint(6, 6 * joints + 6), by_parameter(6, p);
  for (int n = 0; n < rows; ++n) {
    const SE3 seen = base * robot.place(q + n * robot.model.nq) * tool;
    Eigen::Map<Eigen::VectorXd> r(residuals + n * d, d);
    r.head<3>() = Eigen::Map<const Eigen::Vector3d>(positions + 3 * n) - seen.translation();
    by_twist.topLeftCorner<3, 3>() = -seen.rotation();
    if (d == 6) {
      const Eigen::Matrix3d turn = seen.rotation().transpose() * Eigen::Map<const Rotation>(rotations + 9 * n);
      r.tail<3>() = log3(turn);
      // log(exp(-w) exp(r)) = r - Jl(r)^-1 w, and Jl(r) = Jr(-r).
      Eigen::Matrix3d inverse;
      Jlog3(Eigen::Matrix3d(turn.transpose()), inverse);
      by_twist.bottomRightCorner<3, 3>() = -inverse;
    }
    const Six by_link = by_twist * to_tool;
    for (int i = 0; i < joints; ++i)
      by_joint.middleCols<6>(6 * i).noalias() = by_link * robot.regressor.middleCols<6>(6 * i);
    by_joint.rightCols<6>() = by_twist;
    by_parameter.setZero();
    for (int k = 0; k < n_entries; ++k) by_parameter.col(at[2 * k + 1]) += shares[k] * by_joint.col(at[2 * k]);
    Eigen::Map<Matrix>(jacobians + n * d * p, d, p) = by_parameter.topRows(d);
  }
}
}
