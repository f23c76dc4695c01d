// A planner to copy: drives to the heading that is free furthest and near that of the goal.
//
// Subscribes: goal_pose, scan, and the robot's pose in the goal's frame: odom, or amcl_pose with the parameter use_map.
// Publishes: cmd_vel, one command for every scan, which is what a simulator in lockstep waits for.

#include <algorithm>
#include <cmath>
#include <memory>
#include <optional>
#include <vector>

#include "geometry_msgs/msg/pose.hpp"
#include "geometry_msgs/msg/pose_stamped.hpp"
#include "geometry_msgs/msg/pose_with_covariance_stamped.hpp"
#include "geometry_msgs/msg/twist.hpp"
#include "nav_msgs/msg/odometry.hpp"
#include "rclcpp/rclcpp.hpp"
#include "sensor_msgs/msg/laser_scan.hpp"

namespace
{

struct Point
{
  double x, y;  // meters as the robot sees it, x ahead
};

constexpr double kSight = 5.0;      // m
constexpr double kHalfWidth = 0.4;  // m, of the corridor that has to be free

// How far, in meters, a corridor in that direction is free of points.
double free_way(const std::vector<Point> & points, double way)
{
  double nearest = kSight;
  for (const auto & point : points) {
    const double ahead = point.x * std::cos(way) + point.y * std::sin(way);
    const double aside = point.y * std::cos(way) - point.x * std::sin(way);
    if (ahead > 0.0 && std::abs(aside) < kHalfWidth) {
      nearest = std::min(nearest, ahead);
    }
  }
  return nearest;
}

// The algorithm: from a goal and a scan to a velocity. Put yours in place.
geometry_msgs::msg::Twist decide(
  const Point & goal, const std::vector<Point> & points, double max_speed, double max_turn)
{
  geometry_msgs::msg::Twist command;
  if (std::hypot(goal.x, goal.y) < 0.2) {
    return command;
  }
  const double goal_heading = std::atan2(goal.y, goal.x);
  double best = -INFINITY;
  double heading = 0.0;
  for (int step = -15; step <= 15; ++step) {
    const double way = 0.1 * step;
    const double worth = free_way(points, way) - std::abs(way - goal_heading);
    if (worth > best) {
      best = worth;
      heading = way;
    }
  }
  command.linear.x = std::clamp(0.4 * free_way(points, 0.0) - 0.1, 0.0, max_speed) * std::cos(heading);
  command.angular.z = std::clamp(2.0 * heading, -max_turn, max_turn);
  return command;
}

}  // namespace

class TemplatePlanner : public rclcpp::Node
{
public:
  TemplatePlanner()
  : Node("template_planner"),
    max_speed_(declare_parameter("max_speed_mps", 0.5)),
    max_turn_(declare_parameter("max_turn_radps", 1.5))
  {
    using geometry_msgs::msg::PoseStamped;
    using geometry_msgs::msg::PoseWithCovarianceStamped;
    using nav_msgs::msg::Odometry;
    commands_ = create_publisher<geometry_msgs::msg::Twist>("cmd_vel", 10);
    goals_ = create_subscription<PoseStamped>(
      "goal_pose", 10, [this](const PoseStamped & message) {goal_ = message.pose;});
    if (declare_parameter("use_map", false)) {
      poses_ = create_subscription<PoseWithCovarianceStamped>(
        "amcl_pose", 10, [this](const PoseWithCovarianceStamped & message) {pose_ = message.pose.pose;});
    } else {
      poses_ = create_subscription<Odometry>(
        "odom", 10, [this](const Odometry & message) {pose_ = message.pose.pose;});
    }
    scans_ = create_subscription<sensor_msgs::msg::LaserScan>(
      "scan", rclcpp::SensorDataQoS(),
      [this](const sensor_msgs::msg::LaserScan & scan) {commands_->publish(answer(scan));});
  }

private:
  // The command for a scan; a standstill while goal or pose are missing.
  geometry_msgs::msg::Twist answer(const sensor_msgs::msg::LaserScan & scan) const
  {
    if (!goal_ || !pose_) {
      return geometry_msgs::msg::Twist();
    }
    const double yaw = 2.0 * std::atan2(pose_->orientation.z, pose_->orientation.w);
    const double dx = goal_->position.x - pose_->position.x;
    const double dy = goal_->position.y - pose_->position.y;
    const Point goal{std::cos(yaw) * dx + std::sin(yaw) * dy, std::cos(yaw) * dy - std::sin(yaw) * dx};
    std::vector<Point> points;
    points.reserve(scan.ranges.size());
    for (std::size_t i = 0; i < scan.ranges.size(); ++i) {
      if (std::isfinite(scan.ranges[i])) {  // +inf: nothing seen; -inf and NaN: no reading
        const double bearing = scan.angle_min + static_cast<double>(i) * scan.angle_increment;
        points.push_back({scan.ranges[i] * std::cos(bearing), scan.ranges[i] * std::sin(bearing)});
      }
    }
    return decide(goal, points, max_speed_, max_turn_);
  }

  double max_speed_, max_turn_;
  std::optional<geometry_msgs::msg::Pose> goal_, pose_;
  rclcpp::Publisher<geometry_msgs::msg::Twist>::SharedPtr commands_;
  rclcpp::SubscriptionBase::SharedPtr goals_, poses_, scans_;
};

int main(int argc, char ** argv)
{
  rclcpp::init(argc, argv);
  rclcpp::spin(std::make_shared<TemplatePlanner>());
  rclcpp::shutdown();
  return 0;
}
