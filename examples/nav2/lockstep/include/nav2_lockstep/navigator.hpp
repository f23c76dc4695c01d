// A planner and a controller of Nav2, asked in turn: one command for one observation.

#ifndef NAV2_LOCKSTEP__NAVIGATOR_HPP_
#define NAV2_LOCKSTEP__NAVIGATOR_HPP_

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "geometry_msgs/msg/pose.hpp"
#include "geometry_msgs/msg/pose_stamped.hpp"
#include "geometry_msgs/msg/transform.hpp"
#include "geometry_msgs/msg/twist.hpp"
#include "nav2_core/controller.hpp"
#include "nav2_core/global_planner.hpp"
#include "nav2_core/goal_checker.hpp"
#include "nav2_core/progress_checker.hpp"
#include "nav2_lockstep/stepped_costmap.hpp"
#include "nav2_lockstep/versions.hpp"
#include "nav_msgs/msg/odometry.hpp"
#include "nav_msgs/msg/path.hpp"
#include "pluginlib/class_loader.hpp"

namespace nav2_lockstep
{

// What is known at one instant. `map_pose` is the robot's pose in `map_frame` where there is a map.
struct Observation
{
  nav_msgs::msg::Odometry odometry;
  sensor_msgs::msg::LaserScan::ConstSharedPtr scan;
  std::optional<geometry_msgs::msg::Pose> map_pose;
  std::string map_frame;
};

struct Settings
{
  double replan_period_s;               // simulated time between two plans
  geometry_msgs::msg::Transform mount;  // of the lidar on the robot's base frame
};

class Navigator
{
public:
  // Load the first planner, controller, goal and progress checker that the parameters list. Nodes are named as those
  // of Nav2, so that they take the parameters of Nav2's own files. Throws what Nav2 and pluginlib throw.
  explicit Navigator(const Settings & settings);
  ~Navigator();
  Navigator(const Navigator &) = delete;
  Navigator & operator=(const Navigator &) = delete;

  // Give the goal; a plan to it is made with the next observation.
  void set_goal(const geometry_msgs::msg::PoseStamped & goal);

  // What is missing before it can drive; empty if nothing is.
  std::string missing() const;

  // Take an observation, later than the one before, and return the command for it.
  geometry_msgs::msg::Twist step(const Observation & observation);

  // The plan that the controller follows, empty where there is none.
  const nav_msgs::msg::Path & plan() const {return plan_;}

  // How often planner or controller have failed.
  int failures() const {return failures_;}

  const SteppedCostmap & local_costmap() const {return local_;}
  const SteppedCostmap & global_costmap() const {return global_;}

  // What an executor is to spin, so that a static layer gets its map and all parameters can be asked for.
  std::vector<rclcpp::node_interfaces::NodeBaseInterface::SharedPtr> nodes() const;

private:
  template<typename Plugin>
  std::shared_ptr<Plugin> load(
    pluginlib::ClassLoader<Plugin> & loader, const nav2::LifecycleNode::SharedPtr & node,
    const std::string & list, std::string & name);
  void observe(const Observation & observation);
  void make_plan();
  geometry_msgs::msg::Twist follow(const geometry_msgs::msg::Twist & measured);
  geometry_msgs::msg::TwistStamped command(
    const geometry_msgs::msg::PoseStamped & pose, const geometry_msgs::msg::Twist & velocity);
  void recover(const std::string & reason);

  Settings settings_;
  rclcpp::Time now_;
  nav2::LifecycleNode::SharedPtr controller_node_, planner_node_;
  SteppedCostmap local_, global_;
  pluginlib::ClassLoader<nav2_core::GlobalPlanner> planner_loader_;
  pluginlib::ClassLoader<nav2_core::Controller> controller_loader_;
  pluginlib::ClassLoader<nav2_core::GoalChecker> goal_loader_;
  pluginlib::ClassLoader<nav2_core::ProgressChecker> progress_loader_;
  std::shared_ptr<nav2_core::GlobalPlanner> planner_;
  std::shared_ptr<nav2_core::Controller> controller_;
  std::shared_ptr<nav2_core::GoalChecker> goal_checker_;
  std::shared_ptr<nav2_core::ProgressChecker> progress_checker_;
#if NAV2_MINOR >= 5
  pluginlib::ClassLoader<nav2_core::PathHandler> handler_loader_;
  std::shared_ptr<nav2_core::PathHandler> path_handler_;
  nav_msgs::msg::Path local_plan_;  // what the controller was last given of the plan
#endif
  double min_x_, min_y_, min_theta_, failure_tolerance_s_;
  std::optional<geometry_msgs::msg::PoseStamped> goal_;
  bool reached_ = false;
  nav_msgs::msg::Path plan_;
  rclcpp::Time planned_, last_valid_;
  int failures_ = 0;
};

}  // namespace nav2_lockstep

#endif  // NAV2_LOCKSTEP__NAVIGATOR_HPP_
