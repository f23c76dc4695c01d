#include "nav2_lockstep/navigator.hpp"

#include <cmath>
#include <stdexcept>
#include <vector>

#include "nav2_core/controller_exceptions.hpp"
#include "nav2_core/planner_exceptions.hpp"
#include "tf2_geometry_msgs/tf2_geometry_msgs.hpp"

namespace nav2_lockstep
{

namespace
{

// A node with Nav2's name for it, whose clock shows simulated time.
nav2::LifecycleNode::SharedPtr make_server(const std::string & name)
{
  auto options = rclcpp::NodeOptions().append_parameter_override("use_sim_time", false);
  auto node = std::make_shared<nav2::LifecycleNode>(name, "", options);
  take_over_clock(node->get_clock());
  return node;
}

// Zero for what is too slow to be a motion, as Nav2's controller server has it.
double thresholded(double velocity, double threshold)
{
  return std::abs(velocity) > threshold ? velocity : 0.0;
}

geometry_msgs::msg::TransformStamped transform(
  const std::string & parent, const std::string & child, const rclcpp::Time & stamp,
  const geometry_msgs::msg::Transform & value)
{
  geometry_msgs::msg::TransformStamped message;
  message.header.stamp = stamp;
  message.header.frame_id = parent;
  message.child_frame_id = child;
  message.transform = value;
  return message;
}

// The same numbers as the message has: by way of a rotation matrix the last bits would be others.
geometry_msgs::msg::Transform as_transform(const geometry_msgs::msg::Pose & pose)
{
  geometry_msgs::msg::Transform value;
  value.translation.x = pose.position.x;
  value.translation.y = pose.position.y;
  value.translation.z = pose.position.z;
  value.rotation = pose.orientation;
  return value;
}

}  // namespace

Navigator::Navigator(const Settings & settings)
: settings_(settings),
  now_(0, 0, RCL_ROS_TIME),
  controller_node_(make_server("controller_server")),
  planner_node_(make_server("planner_server")),
  local_("local_costmap"),
  global_("global_costmap"),
  planner_loader_("nav2_core", "nav2_core::GlobalPlanner"),
  controller_loader_("nav2_core", "nav2_core::Controller"),
  goal_loader_("nav2_core", "nav2_core::GoalChecker"),
  progress_loader_("nav2_core", "nav2_core::ProgressChecker"),
#if NAV2_MINOR >= 5
  handler_loader_("nav2_core", "nav2_core::PathHandler"),
#endif
  planned_(now_),
  last_valid_(now_)
{
  // with the defaults of Nav2's controller server and planner server, on whose nodes plugins look for them
  auto & node = controller_node_;
  node->declare_parameter("controller_frequency", 20.0);
  node->declare_parameter("controller_plugins", std::vector<std::string>{"FollowPath"});
  node->declare_parameter("goal_checker_plugins", std::vector<std::string>{"goal_checker"});
  node->declare_parameter("progress_checker_plugins", std::vector<std::string>{"progress_checker"});
  min_x_ = node->declare_parameter("min_x_velocity_threshold", 0.0001);
  min_y_ = node->declare_parameter("min_y_velocity_threshold", 0.0001);
  min_theta_ = node->declare_parameter("min_theta_velocity_threshold", 0.0001);
  failure_tolerance_s_ = node->declare_parameter("failure_tolerance", 0.0);
  planner_node_->declare_parameter("expected_planner_frequency", 1.0);
  planner_node_->declare_parameter("planner_plugins", std::vector<std::string>{"GridBased"});

  std::string name;
  goal_checker_ = load(goal_loader_, node, "goal_checker_plugins", name);
  goal_checker_->initialize(node, name, local_.ros());
  progress_checker_ = load(progress_loader_, node, "progress_checker_plugins", name);
  progress_checker_->initialize(node, name);
#if NAV2_MINOR >= 5
  node->declare_parameter("path_handler_plugins", std::vector<std::string>{"PathHandler"});
  nav2::declare_parameter_if_not_declared(
    node, "PathHandler.plugin", rclcpp::ParameterValue("nav2_controller::FeasiblePathHandler"));
  path_handler_ = load(handler_loader_, node, "path_handler_plugins", name);
  path_handler_->initialize(node, node->get_logger(), name, local_.ros(), local_.ros()->getTfBuffer());
#endif
  controller_ = load(controller_loader_, node, "controller_plugins", name);
  controller_->configure(node, name, local_.ros()->getTfBuffer(), local_.ros());
  controller_->activate();
  planner_ = load(planner_loader_, planner_node_, "planner_plugins", name);
  planner_->configure(planner_node_, name, global_.ros()->getTfBuffer(), global_.ros());
  planner_->activate();
}

Navigator::~Navigator()
{
  controller_->deactivate();
  controller_->cleanup();
  planner_->deactivate();
  planner_->cleanup();
}

template<typename Plugin>
std::shared_ptr<Plugin> Navigator::load(
  pluginlib::ClassLoader<Plugin> & loader, const nav2::LifecycleNode::SharedPtr & node,
  const std::string & list, std::string & name)
{
  const auto names = node->get_parameter(list).as_string_array();
  if (names.empty()) {
    throw std::runtime_error(std::string(node->get_name()) + ": " + list + " is empty");
  }
  name = names.front();
  return loader.createSharedInstance(nav2::get_plugin_type_param(node, name));
}

std::vector<rclcpp::node_interfaces::NodeBaseInterface::SharedPtr> Navigator::nodes() const
{
  return {
    controller_node_->get_node_base_interface(), planner_node_->get_node_base_interface(),
    local_.ros()->get_node_base_interface(), global_.ros()->get_node_base_interface()};
}

void Navigator::set_goal(const geometry_msgs::msg::PoseStamped & goal)
{
  goal_ = goal;
  goal_->header.stamp = builtin_interfaces::msg::Time();  // where it is at any time
  plan_ = nav_msgs::msg::Path();
  reached_ = false;
}

std::string Navigator::missing() const
{
  if (!goal_) {
    return "no goal yet";
  }
  return local_.is_current() && global_.is_current() ? "" : "a costmap waits for its map";
}

geometry_msgs::msg::Twist Navigator::step(const Observation & observation)
{
  observe(observation);
  if (const auto lacks = missing(); !lacks.empty()) {
    RCLCPP_WARN_THROTTLE(
      controller_node_->get_logger(), *controller_node_->get_clock(), 1000, "standing still: %s", lacks.c_str());
    return geometry_msgs::msg::Twist();
  }
  if (reached_) {
    return geometry_msgs::msg::Twist();
  }
  try {
    if (plan_.poses.empty() || (now_ - planned_).seconds() >= settings_.replan_period_s) {
      make_plan();
    }
    return follow(observation.odometry.twist.twist);
  } catch (const std::exception & error) {
    // whatever a plugin throws, as in Nav2's servers
    recover(error.what());
    return geometry_msgs::msg::Twist();
  }
}

void Navigator::observe(const Observation & observation)
{
  const auto & odometry = observation.odometry;
  const auto & base = odometry.child_frame_id;
  now_ = rclcpp::Time(observation.scan->header.stamp, RCL_ROS_TIME);
  set_time(controller_node_->get_clock(), now_);
  set_time(planner_node_->get_clock(), now_);
  for (auto * costmap : {&local_, &global_}) {
    costmap->set_time(now_);
    costmap->set_transform(
      transform(base, observation.scan->header.frame_id, now_, settings_.mount), true);
    costmap->set_transform(
      transform(odometry.header.frame_id, base, now_, as_transform(odometry.pose.pose)), false);
    if (observation.map_pose) {
      tf2::Transform located, driven;
      tf2::fromMsg(*observation.map_pose, located);
      tf2::fromMsg(odometry.pose.pose, driven);
      const auto correction = tf2::toMsg(located * driven.inverse());
      costmap->set_transform(
        transform(observation.map_frame, odometry.header.frame_id, now_, correction), false);
    }
    costmap->update(observation.scan);
  }
}

void Navigator::make_plan()
{
  const bool first = plan_.poses.empty();
  geometry_msgs::msg::PoseStamped start, goal;
  if (!global_.ros()->getRobotPose(start) ||
    !global_.ros()->transformPoseToGlobalFrame(*goal_, goal))
  {
    throw nav2_core::PlannerTFError("the robot or the goal is not known in the planner's frame");
  }
#if NAV2_MINOR >= 5
  plan_ = planner_->createPlan(start, goal, {}, [] {return false;});
#else
  plan_ = planner_->createPlan(start, goal, [] {return false;});
#endif
  if (plan_.poses.empty()) {
    throw nav2_core::NoValidPathCouldBeFound("no path to the goal");
  }
  planned_ = now_;
#if NAV2_MINOR >= 5
  controller_->newPathReceived(plan_);
  path_handler_->setPlan(plan_);
#else
  controller_->setPlan(plan_);
#endif
  goal_checker_->reset();
  if (first) {
    progress_checker_->reset();
    last_valid_ = now_;
  }
}

geometry_msgs::msg::Twist Navigator::follow(const geometry_msgs::msg::Twist & measured)
{
  geometry_msgs::msg::PoseStamped pose, end;
  auto last = plan_.poses.back();
  last.header = plan_.header;
  if (!local_.ros()->getRobotPose(pose)) {
    throw nav2_core::ControllerTFError("the robot is not known in the controller's frame");
  }
  last.header.stamp = pose.header.stamp;
  if (!local_.ros()->transformPoseToGlobalFrame(last, end)) {
    throw nav2_core::ControllerTFError("the end of the plan is not known in the controller's frame");
  }
  geometry_msgs::msg::Twist velocity;
  velocity.linear.x = thresholded(measured.linear.x, min_x_);
  velocity.linear.y = thresholded(measured.linear.y, min_y_);
  velocity.angular.z = thresholded(measured.angular.z, min_theta_);
#if NAV2_MINOR >= 5
  reached_ = goal_checker_->isGoalReached(pose.pose, end.pose, velocity, local_plan_);
#else
  reached_ = goal_checker_->isGoalReached(pose.pose, end.pose, velocity);
#endif
  if (reached_) {
    controller_->reset();
    return geometry_msgs::msg::Twist();
  }
  if (!progress_checker_->check(pose)) {
    throw nav2_core::FailedToMakeProgress("no progress");
  }
  try {
    const auto answer = command(pose, velocity);
    last_valid_ = now_;
    return answer.twist;
  } catch (const nav2_core::NoValidControl &) {
    // as in Nav2's controller server: stand still, and fail only once it lasts
    const bool patient = failure_tolerance_s_ == -1.0 ||
      (failure_tolerance_s_ > 0.0 && (now_ - last_valid_).seconds() <= failure_tolerance_s_);
    if (!patient) {
      throw;
    }
    return geometry_msgs::msg::Twist();
  }
}

geometry_msgs::msg::TwistStamped Navigator::command(
  const geometry_msgs::msg::PoseStamped & pose, const geometry_msgs::msg::Twist & velocity)
{
#if NAV2_MINOR >= 5
  const auto goal = path_handler_->getTransformedGoal(pose.header.stamp);
  const auto [begin, end] = path_handler_->findPlanSegment(pose);
  local_plan_ = path_handler_->transformLocalPlan(begin, end);
  return controller_->computeVelocityCommands(pose, velocity, goal_checker_.get(), local_plan_, goal);
#else
  return controller_->computeVelocityCommands(pose, velocity, goal_checker_.get());
#endif
}

void Navigator::recover(const std::string & reason)
{
  ++failures_;
  RCLCPP_WARN_THROTTLE(
    controller_node_->get_logger(), *controller_node_->get_clock(), 1000,
    "%s: costmaps cleared, planning anew", reason.c_str());
  controller_->reset();
  local_.clear();
  global_.clear();
  plan_ = nav_msgs::msg::Path();
}

}  // namespace nav2_lockstep
