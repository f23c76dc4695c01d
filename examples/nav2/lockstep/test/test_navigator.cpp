// The host adds nothing: its commands are those of the plugins called as Nav2's servers call them.
//
// Both drive through the same world of cylinders. The direct way below is written out plainly, without the host.

#include <cmath>
#include <string>
#include <vector>

#include "gtest/gtest.h"
#include "nav2_lockstep/navigator.hpp"
#include "nav2_util/node_utils.hpp"
#include "tf2/utils.h"

using geometry_msgs::msg::Twist;
using nav2_lockstep::Navigator;
using nav2_lockstep::Observation;
using nav2_lockstep::Settings;

namespace
{

constexpr double kPeriod_s = 0.05;
constexpr double kReplan_s = 1.0;
constexpr double kLidarX_m = 0.055;
constexpr int kSteps = 1000;

struct Cylinder {double x, y, radius;};

const std::vector<Cylinder> kWorld{
  {2.0, 0.3, 0.2}, {3.5, -0.6, 0.3}, {5.0, 0.5, 0.25}, {6.5, -0.2, 0.2}, {8.0, 0.9, 0.3}};

geometry_msgs::msg::Transform mount()
{
  geometry_msgs::msg::Transform transform;
  transform.translation.x = kLidarX_m;
  transform.translation.z = 0.241;
  return transform;
}

geometry_msgs::msg::Quaternion heading(double yaw)
{
  geometry_msgs::msg::Quaternion rotation;
  rotation.z = std::sin(0.5 * yaw);
  rotation.w = std::cos(0.5 * yaw);
  return rotation;
}

geometry_msgs::msg::PoseStamped goal()
{
  geometry_msgs::msg::PoseStamped pose;
  pose.header.frame_id = "odom";
  pose.pose.position.x = 10.0;
  return pose;
}

// A robot that does at once what it is told.
struct Robot
{
  double x = 0.0, y = 0.0, yaw = 0.0;
  Twist last;

  void drive(const Twist & command)
  {
    last = command;
    x += kPeriod_s * command.linear.x * std::cos(yaw);
    y += kPeriod_s * command.linear.x * std::sin(yaw);
    yaw += kPeriod_s * command.angular.z;
  }

  Observation observe(int step) const
  {
    const rclcpp::Time stamp(1'000'000'000 + step * 50'000'000LL, RCL_ROS_TIME);
    Observation observation;
    observation.odometry.header.stamp = stamp;
    observation.odometry.header.frame_id = "odom";
    observation.odometry.child_frame_id = "base_link";
    observation.odometry.pose.pose.position.x = x;
    observation.odometry.pose.pose.position.y = y;
    observation.odometry.pose.pose.orientation = heading(yaw);
    observation.odometry.twist.twist = last;
    observation.scan = scan(stamp);
    return observation;
  }

  sensor_msgs::msg::LaserScan::ConstSharedPtr scan(const rclcpp::Time & stamp) const
  {
    auto message = std::make_shared<sensor_msgs::msg::LaserScan>();
    message->header.stamp = stamp;
    message->header.frame_id = "lidar_link";
    message->angle_min = -2.356f;
    message->angle_max = 2.356f;
    message->angle_increment = 4.712f / 359.0f;
    message->range_min = 0.1f;
    message->range_max = 30.0f;
    const double lidar_x = x + kLidarX_m * std::cos(yaw), lidar_y = y + kLidarX_m * std::sin(yaw);
    for (int ray = 0; ray < 360; ++ray) {
      const double angle = yaw + message->angle_min + ray * message->angle_increment;
      double nearest = INFINITY;
      for (const auto & cylinder : kWorld) {
        const double dx = cylinder.x - lidar_x, dy = cylinder.y - lidar_y;
        const double along = dx * std::cos(angle) + dy * std::sin(angle);
        const double aside = dy * std::cos(angle) - dx * std::sin(angle);
        if (along > 0.0 && std::abs(aside) < cylinder.radius) {
          nearest = std::min(
            nearest, along - std::sqrt(cylinder.radius * cylinder.radius - aside * aside));
        }
      }
      message->ranges.push_back(static_cast<float>(nearest));
    }
    return message;
  }
};

// Gives access to what a layer's subscriptions fill.
struct Buffers : nav2_costmap_2d::ObstacleLayer
{
  static auto & of(nav2_costmap_2d::ObstacleLayer & layer)
  {
    return layer.*(&Buffers::observation_buffers_);
  }
};

// The plugins, asked without the host.
class Direct
{
public:
  Direct()
  : controllers_("nav2_core", "nav2_core::Controller"),
    planners_("nav2_core", "nav2_core::GlobalPlanner"),
    goals_("nav2_core", "nav2_core::GoalChecker")
  {
    for (auto * costmap : {&local_, &global_}) {
      override_clock(**costmap);
      (*costmap)->configure();
      (*costmap)->getTfBuffer()->setUsingDedicatedThread(true);
    }
    override_clock(*node_);
    node_->declare_parameter("controller_frequency", 20.0);
    min_x_ = node_->declare_parameter("min_x_velocity_threshold", 0.0001);
    min_y_ = node_->declare_parameter("min_y_velocity_threshold", 0.0001);
    min_theta_ = node_->declare_parameter("min_theta_velocity_threshold", 0.0001);
    goal_checker_ = goals_.createSharedInstance(nav2_util::get_plugin_type_param(node_, "goal_checker"));
    goal_checker_->initialize(node_, "goal_checker", local_);
    controller_ = controllers_.createSharedInstance(nav2_util::get_plugin_type_param(node_, "FollowPath"));
    controller_->configure(node_, "FollowPath", local_->getTfBuffer(), local_);
    controller_->activate();
    planner_ = planners_.createSharedInstance(nav2_util::get_plugin_type_param(server_, "GridBased"));
    planner_->configure(server_, "GridBased", global_->getTfBuffer(), global_);
    planner_->activate();
  }

  Twist step(const Observation & observation, int number)
  {
    const rclcpp::Time now(observation.scan->header.stamp, RCL_ROS_TIME);
    set_clock(*node_, now);
    for (const auto & costmap : {local_, global_}) {
      set_clock(*costmap, now);
      geometry_msgs::msg::TransformStamped transform;
      transform.header.stamp = now;
      transform.header.frame_id = "base_link";
      transform.child_frame_id = "lidar_link";
      transform.transform = mount();
      costmap->getTfBuffer()->setTransform(transform, "test", true);
      transform.header.frame_id = "odom";
      transform.child_frame_id = "base_link";
      transform.transform.translation.x = observation.odometry.pose.pose.position.x;
      transform.transform.translation.y = observation.odometry.pose.pose.position.y;
      transform.transform.translation.z = 0.0;
      transform.transform.rotation = observation.odometry.pose.pose.orientation;
      costmap->getTfBuffer()->setTransform(transform, "test", false);
      auto layer = std::dynamic_pointer_cast<nav2_costmap_2d::ObstacleLayer>(
        costmap->getLayeredCostmap()->getPlugins()->front());
      layer->laserScanValidInfCallback(observation.scan, Buffers::of(*layer).front());
      costmap->updateMap();
    }
    geometry_msgs::msg::PoseStamped pose;
    if (number % static_cast<int>(std::lround(kReplan_s / kPeriod_s)) == 0) {
      EXPECT_TRUE(global_->getRobotPose(pose));
      plan_ = planner_->createPlan(pose, goal(), [] {return false;});
      controller_->setPlan(plan_);
      goal_checker_->reset();
    }
    EXPECT_TRUE(local_->getRobotPose(pose));
    Twist velocity = observation.odometry.twist.twist;
    velocity.linear.x = std::abs(velocity.linear.x) > min_x_ ? velocity.linear.x : 0.0;
    velocity.linear.y = std::abs(velocity.linear.y) > min_y_ ? velocity.linear.y : 0.0;
    velocity.angular.z = std::abs(velocity.angular.z) > min_theta_ ? velocity.angular.z : 0.0;
    if (reached_ || goal_checker_->isGoalReached(pose.pose, plan_.poses.back().pose, velocity)) {
      reached_ = true;
      return Twist();
    }
    return controller_->computeVelocityCommands(pose, velocity, goal_checker_.get()).twist;
  }

private:
  template<typename Node>
  static void override_clock(Node & node)
  {
    ASSERT_EQ(rcl_enable_ros_time_override(node.get_clock()->get_clock_handle()), RCL_RET_OK);
  }


  template<typename Node>
  static void set_clock(Node & node, const rclcpp::Time & now)
  {
    ASSERT_EQ(
      rcl_set_ros_time_override(node.get_clock()->get_clock_handle(), now.nanoseconds()), RCL_RET_OK);
  }

  std::shared_ptr<nav2_costmap_2d::Costmap2DROS> local_{
    std::make_shared<nav2_costmap_2d::Costmap2DROS>("local_costmap", "/", "local_costmap", false)};
  std::shared_ptr<nav2_costmap_2d::Costmap2DROS> global_{
    std::make_shared<nav2_costmap_2d::Costmap2DROS>("global_costmap", "/", "global_costmap", false)};
  nav2_util::LifecycleNode::SharedPtr node_{
    std::make_shared<nav2_util::LifecycleNode>("controller_server")};
  nav2_util::LifecycleNode::SharedPtr server_{
    std::make_shared<nav2_util::LifecycleNode>("planner_server")};
  pluginlib::ClassLoader<nav2_core::Controller> controllers_;
  pluginlib::ClassLoader<nav2_core::GlobalPlanner> planners_;
  pluginlib::ClassLoader<nav2_core::GoalChecker> goals_;
  std::shared_ptr<nav2_core::Controller> controller_;
  std::shared_ptr<nav2_core::GlobalPlanner> planner_;
  std::shared_ptr<nav2_core::GoalChecker> goal_checker_;
  double min_x_, min_y_, min_theta_;
  nav_msgs::msg::Path plan_;
  bool reached_ = false;
};

class WithParameters : public testing::TestWithParam<const char *>
{
protected:
  void SetUp() override
  {
    std::vector<std::string> arguments{"test", "--ros-args"};
    for (const std::string name : {"common", "mapless", GetParam()}) {
      arguments.insert(arguments.end(), {"--params-file", PARAMS + name + ".yaml"});
    }
    std::vector<const char *> raw;
    for (const auto & argument : arguments) {
      raw.push_back(argument.c_str());
    }
    rclcpp::init(static_cast<int>(raw.size()), raw.data());
  }

  void TearDown() override {rclcpp::shutdown();}
};

TEST_P(WithParameters, CommandsAreThoseOfThePluginsCalledDirectly)
{
  Robot robot;
  std::vector<Observation> observations;
  std::vector<Twist> commands;
  {
    Navigator host(Settings{kReplan_s, mount()});
    host.set_goal(goal());
    for (int i = 0; i < kSteps; ++i) {
      observations.push_back(robot.observe(i));
      commands.push_back(host.step(observations.back()));
      robot.drive(commands.back());
    }
    EXPECT_EQ(host.failures(), 0);
  }
  EXPECT_GT(robot.x, 9.0);  // it has driven
  Direct direct;
  for (int i = 0; i < kSteps; ++i) {
    ASSERT_EQ(direct.step(observations[i], i), commands[i]) << "at step " << i;
  }
}

TEST_P(WithParameters, AsksForWhatItLacks)
{
  Navigator host(Settings{kReplan_s, mount()});
  EXPECT_EQ(host.missing(), "no goal yet");
  EXPECT_EQ(host.step(Robot().observe(0)), Twist());
  host.set_goal(goal());
  EXPECT_EQ(host.missing(), "");
}

TEST_P(WithParameters, StandsStillAndPlansAnewWhereThereIsNoWay)
{
  Navigator host(Settings{kReplan_s, mount()});
  auto far = goal();
  far.pose.position.x = 1000.0;  // off the global costmap
  host.set_goal(far);
  for (int i = 0; i < 3; ++i) {
    EXPECT_EQ(host.step(Robot().observe(i)), Twist());
    EXPECT_EQ(host.failures(), i + 1);
    EXPECT_TRUE(host.plan().poses.empty());
  }
  host.set_goal(goal());
  EXPECT_NE(host.step(Robot().observe(3)), Twist());
}

INSTANTIATE_TEST_SUITE_P(
  Controllers, WithParameters, testing::Values("rpp", "dwb"),
  [](const auto & info) {return std::string(info.param);});

}  // namespace
