// A planner and a controller of Nav2 in lockstep with a simulator: exactly one command for each scan.
//
// Subscribes: scan, odom, goal_pose; with the parameter use_map also amcl_pose, and Nav2's static layer its map.
// Publishes: cmd_vel, and plan when there is a new one. Services: ~/ready, ~/reset (Trigger).

#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdio>
#include <memory>
#include <vector>

#include "geometry_msgs/msg/pose_with_covariance_stamped.hpp"
#include "nav2_lockstep/navigator.hpp"
#include "std_srvs/srv/trigger.hpp"

namespace nav2_lockstep
{

class LockstepNode : public rclcpp::Node
{
public:
  explicit LockstepNode(rclcpp::Executor & executor)
  : Node("nav2_lockstep"), executor_(executor), use_map_(declare_parameter("use_map", false))
  {
    settings_.replan_period_s = declare_parameter("replan_period_s", 1.0);  // as Nav2's own tree
    // where the suite's Jackal carries its lidar
    settings_.mount.translation.x = declare_parameter("lidar_x_m", 0.055);
    settings_.mount.translation.y = declare_parameter("lidar_y_m", 0.0);
    settings_.mount.translation.z = declare_parameter("lidar_z_m", 0.241);
    const double yaw = declare_parameter("lidar_yaw_rad", 0.0);
    settings_.mount.rotation.z = std::sin(0.5 * yaw);
    settings_.mount.rotation.w = std::cos(0.5 * yaw);
    open();
    begin();
  }

  ~LockstepNode() override {end();}

private:
  void open()
  {
    using geometry_msgs::msg::PoseStamped;
    using geometry_msgs::msg::PoseWithCovarianceStamped;
    using std_srvs::srv::Trigger;
    commands_ = create_publisher<geometry_msgs::msg::Twist>("cmd_vel", 10);
    plans_ = create_publisher<nav_msgs::msg::Path>("plan", 1);
    subscriptions_.push_back(
      create_subscription<PoseStamped>(
        "goal_pose", 10, [this](const PoseStamped & goal) {navigator_->set_goal(goal);}));
    subscriptions_.push_back(
      create_subscription<nav_msgs::msg::Odometry>(
        "odom", 10, [this](const nav_msgs::msg::Odometry & odometry) {
          observation_.odometry = odometry;
          answer();
        }));
    subscriptions_.push_back(
      create_subscription<sensor_msgs::msg::LaserScan>(
        "scan", rclcpp::QoS(10), [this](sensor_msgs::msg::LaserScan::ConstSharedPtr scan) {
          observation_.scan = scan;
          answer();
        }));
    if (use_map_) {
      subscriptions_.push_back(
        create_subscription<PoseWithCovarianceStamped>(
          "amcl_pose", 10, [this](const PoseWithCovarianceStamped & pose) {
            observation_.map_pose = pose.pose.pose;
            observation_.map_frame = pose.header.frame_id;
            located_ = pose.header.stamp;
            answer();
          }));
    }
    services_.push_back(
      create_service<Trigger>(
        "~/ready", [this](const Trigger::Request::SharedPtr, Trigger::Response::SharedPtr response) {
          response->message = navigator_->missing();
          response->success = response->message.empty();
        }));
    services_.push_back(
      create_service<Trigger>(
        "~/reset", [this](const Trigger::Request::SharedPtr, Trigger::Response::SharedPtr response) {
          end();
          begin();
          response->success = true;
        }));
  }

  void begin()
  {
    observation_ = Observation();
    navigator_ = std::make_unique<Navigator>(settings_);
    for (const auto & node : navigator_->nodes()) {
      executor_.add_node(node);
    }
  }

  void end()
  {
    for (const auto & node : navigator_->nodes()) {
      executor_.remove_node(node);
    }
    navigator_.reset();
  }

  // Answer the scan once the other readings of its instant are there: topics have no order among each other.
  void answer()
  {
    const auto scan = observation_.scan;
    if (!scan || observation_.odometry.header.stamp != scan->header.stamp ||
      (use_map_ && (!observation_.map_pose || located_ != scan->header.stamp)))
    {
      return;
    }
    const auto planned = navigator_->plan().header.stamp;
    commands_->publish(navigator_->step(observation_));
    if (!navigator_->plan().poses.empty() && navigator_->plan().header.stamp != planned) {
      plans_->publish(navigator_->plan());
    }
    observation_.scan.reset();
  }

  rclcpp::Executor & executor_;
  const bool use_map_;
  Settings settings_;
  Observation observation_;
  builtin_interfaces::msg::Time located_;
  std::unique_ptr<Navigator> navigator_;
  rclcpp::Publisher<geometry_msgs::msg::Twist>::SharedPtr commands_;
  rclcpp::Publisher<nav_msgs::msg::Path>::SharedPtr plans_;
  std::vector<rclcpp::SubscriptionBase::SharedPtr> subscriptions_;
  std::vector<rclcpp::ServiceBase::SharedPtr> services_;
};

}  // namespace nav2_lockstep

namespace
{

std::atomic<bool> stopping{false};

}  // namespace

int main(int argc, char ** argv)
{
  // Costmaps listen to /tf from a thread of their own: what they knew would depend on when it came. The host tells them
  // all transforms itself.
  std::vector<const char *> arguments(argv, argv + argc);
  for (const char * word :
    {"--ros-args", "-r", "/tf:=/nav2_lockstep/no_tf", "-r", "/tf_static:=/nav2_lockstep/no_tf_static"})
  {
    arguments.push_back(word);
  }
  // rclcpp's own handling would clean up Nav2's nodes from another thread, in the middle of a step
  rclcpp::init(
    static_cast<int>(arguments.size()), arguments.data(), rclcpp::InitOptions(), rclcpp::SignalHandlerOptions::None);
  std::signal(SIGINT, [](int) {stopping = true;});
  std::signal(SIGTERM, [](int) {stopping = true;});
  int result = 0;
  try {
    rclcpp::executors::SingleThreadedExecutor executor;
    auto node = std::make_shared<nav2_lockstep::LockstepNode>(executor);
    executor.add_node(node);
    while (!stopping) {
      executor.spin_once(std::chrono::milliseconds(100));
    }
    executor.remove_node(node);
  } catch (const std::exception & error) {
    std::fprintf(stderr, "nav2_lockstep: %s\n", error.what());
    result = 1;
  }
  rclcpp::shutdown();
  return result;
}
